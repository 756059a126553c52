// How the detector learns: a step of its optimiser, and a sample's loss.
#include <algorithm>
#include <mutex>
#include <optional>
#include <stdexcept>

#include "../../torch_threads.h"
#include "augment.h"
#include "base/sizes.h"
#include "fusion_detector.h"
#include "loss.h"
#include "scopes.h"
#include "sensor_tensors.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kMaxGradient = 5.0;
constexpr double kFrozenBelow = 0.3;                   // of the peak rate: from there on norms are affine
constexpr std::size_t kMemory = std::size_t{4} << 30;  // bytes of kept camera output

}  // namespace

CameraOutput FusionDetector::cached_camera_output(const SensorTensors& input, std::uint64_t key) {
  {
    const std::scoped_lock lock(camera_cache_mutex_);
    if (const auto kept = camera_cache_.find(key); key != 0 && kept != camera_cache_.end()) {
      CameraOutput seen = kept->second;
      for (Tensor* part : {&seen.features, &seen.mask, &seen.boxes, &seen.logits})
        if (part->defined()) *part = part->to(torch::kFloat);
      return seen;
    }
  }
  const torch::NoGradGuard guard;
  CameraOutput seen = network_->see(input);
  if (key == 0) return seen;
  CameraOutput small;  // the join's input
  small.mask = seen.mask.to(torch::kHalf);
  if (options_.parts.image) small.features = seen.features.to(torch::kHalf);
  if (options_.parts.late) small.boxes = seen.boxes, small.logits = seen.logits;
  std::size_t bytes = 0;
  for (const Tensor* part : {&small.features, &small.mask, &small.boxes, &small.logits})
    if (part->defined()) bytes += part->nbytes();
  const std::scoped_lock lock(camera_cache_mutex_);
  if (camera_cache_bytes_ + bytes <= kMemory && camera_cache_.emplace(key, small).second)
    camera_cache_bytes_ += bytes;
  return seen;
}

LossTerms FusionDetector::loss_of(const MirageSample& sample, const Targets& targets, std::uint64_t index,
                                  double positives, double boxed) {
  const bool frozen_camera = options_.parts.camera && !camera_learns();
  SensorTensors input = copy_input(sample.input, reads_image());
  LabelledPicture taught;
  if (camera_learns()) taught = labelled_picture(sample, input.image);
  // Without returns no calibration has to follow.
  if (camera_learns() && !options_.parts.lidar && input.image.defined()) {
    taught = augmented_picture(taught, options_.seed, index);
    input.image = taught.image;
  }
  const Bfloat16 rounded(options_.precision == Precision::bfloat16);
  if (input.image.defined() && frozen_camera)
    input.camera = cached_camera_output(input, sample.picture_key);  // of the picture as recorded
  input = augment(input, options_.seed, index, !frozen_camera);
  if (camera_learns()) input.camera = network_->see(input, true);  // boxes are a task
  LossTerms terms{torch::zeros({}), 0, 0};
  if (options_.parts.second && input.image.defined()) {
    const FirstStage first = network_->first_stage(input);
    terms =
        region_loss(network_->second->find_regions(first, input, SecondStageImpl::chosen(first)),
                    {sample.boxes, as_size(sample.box_count)}, {sample.ignore, as_size(sample.ignore_count)});
    if (lidar_learns())
      terms = sum(terms, detection_loss(first.output.to(torch::kFloat), targets, positives, boxed));
  } else if (options_.parts.lidar) {
    terms = detection_loss(network_->forward(input).to(torch::kFloat), targets, positives, boxed);
  }
  if (!camera_learns() || !input.camera.defined()) return terms;
  const LossTerms picture = picture_loss(input.camera, taught.boxes, taught.ignored,
                                         taught.vehicle_mask.empty() ? nullptr : taught.vehicle_mask.data(),
                                         input.image.size(0), input.image.size(1));
  return sum(terms, picture);
}

std::array<float, 3> FusionDetector::train_step(std::span<const MirageSample> samples, float learning_rate) {
  if (samples.empty()) throw std::runtime_error("train_step got no samples; give at least one");
  kept_logits_ = Tensor();
  local_.reset();
  clean_frames_->forget();
  torch::AutoGradMode mode(true);
  const std::vector<Tensor> parameters = learning();
  if (parameters.empty())
    throw std::runtime_error(
        "nothing of the network learns, since all of it was taken over; leave --camera or --lidar out, or "
        "give --joint");
  const ParameterGradients on(parameters);
  std::vector<Targets> targets;
  double positives = 0, boxed = 0;
  for (const MirageSample& sample : samples) {
    targets.push_back(make_targets({sample.boxes, as_size(sample.box_count)},
                                   {sample.ignore, as_size(sample.ignore_count)}));
    positives += targets.back().positives;
    boxed += targets.back().boxed;
  }
  peak_rate_ = std::max<double>(peak_rate_, learning_rate);
  const bool norms_frozen = learning_rate < kFrozenBelow * peak_rate_;
  std::vector<SampleResult> results(samples.size());
  std::vector<std::vector<SampleStatistics::Seen>> statistics(samples.size());
  for_each_sample(samples.size(), options_.threads, [&](std::size_t i) {
    std::optional<SampleStatistics> own;
    if (lidar_learns() && !norms_frozen) own.emplace();
    const LossTerms terms =
        loss_of(samples[i], targets[i], static_cast<std::uint64_t>(samples_seen_) + i, positives, boxed);
    if (!options_.parts.lidar && !terms.total.requires_grad())
      throw std::runtime_error(
          "the mask learns nothing from frames that do not say which pixels show vehicles; make them with "
          "--truth, or train the heads with --heads");
    if (own) statistics[i] = own->seen;
    results[i].loss = {terms.total.item<float>(), static_cast<float>(terms.score),
                       static_cast<float>(terms.box)};
    // Without the picture its branch gets no gradient: allow_unused.
    if (terms.total.requires_grad())
      results[i].gradients = torch::autograd::grad({terms.total}, parameters, {}, {}, false, true);
    else
      results[i].gradients.resize(parameters.size());
  });
  samples_seen_ += static_cast<std::int64_t>(samples.size());
  for (std::size_t i = 0; i < statistics.size(); ++i)
    follow(statistics[i], samples_seen_ - static_cast<std::int64_t>(samples.size() - i) + 1);
  // Each sample's loss is divided already.
  const std::array<float, 3> loss =
      take_step(*optimiser_, parameters, results, 1, kMaxGradient, learning_rate);
  const auto is_finite = [](const Tensor& values) { return torch::isfinite(values).all().item<bool>(); };
  if (!std::ranges::all_of(parameters, is_finite) || !std::ranges::all_of(network_->buffers(), is_finite))
    throw std::runtime_error("the weights are not finite after the step; lower the learning rate");
  ++steps_;
  return loss;
}

}  // namespace mirage::fusion
