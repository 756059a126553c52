#include "fusion_detector.h"

#include <ATen/autocast_mode.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <sstream>
#include <stdexcept>

#include "../../for_each_sample.h"
#include "augment.h"
#include "base/files.h"
#include "loss.h"
#include "region.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr const char* kFormat = "mirage fusion detector 2";
constexpr double kWeightDecay = 0.01, kLargestGradient = 5.0;

/// Own copies: the host may free its memory while the graph lives on.
SensorTensors copy_input(const MirageSensorInput& input, bool with_image) {
  SensorTensors tensors;
  if (with_image && input.image && input.width > 0 && input.height > 0) {
    tensors.image = torch::empty({input.height, input.width, 3});
    std::memcpy(tensors.image.data_ptr<float>(), input.image, sizeof(float) * tensors.image.numel());
  }
  tensors.points = torch::empty({input.points ? input.point_count : 0, 4});
  if (tensors.points.numel() > 0)
    std::memcpy(tensors.points.data_ptr<float>(), input.points, sizeof(float) * tensors.points.numel());
  std::copy(std::begin(input.pixel_from_velo), std::end(input.pixel_from_velo), tensors.projection.begin());
  return tensors;
}

/// The convolutions and linear layers in bfloat16 where asked; everything else, and all weights, stay float.
Tensor training_pass(NetworkImpl& network, const SensorTensors& input, bool bfloat16) {
  if (!bfloat16) return network.forward(input);
  at::autocast::set_autocast_cpu_dtype(at::kBFloat16);
  at::autocast::set_cpu_enabled(true);
  Tensor output = network.forward(input).to(torch::kFloat);
  at::autocast::clear_cache();  // its copies of the weights, which the optimiser is about to change
  at::autocast::set_cpu_enabled(false);
  return output;
}

torch::Device best_device() {
  return torch::cuda::is_available() ? torch::kCUDA : torch::kCPU;
}

torch::serialize::InputArchive open_weights(const std::string& file) {
  torch::serialize::InputArchive archive;
  c10::IValue value;
  try {
    archive.load_from(file, best_device());
  } catch (const std::exception&) {
    throw std::runtime_error("not a readable weights file; restore it, or train anew with mirage train");
  }
  if (!archive.try_read("format", value) || !value.isString() || value.toStringRef() != kFormat)
    throw std::runtime_error("weights of another program or version; train anew with mirage train");
  return archive;
}

Parts parts_of(torch::serialize::InputArchive& archive) {
  // Files of before the choice have neither of the later parts.
  const auto flag = [&](const char* key) {
    c10::IValue value;
    return archive.try_read(key, value) && value.toBool();
  };
  return {flag("with_image"), flag("denoising"), flag("depth_gate")};
}

/// The options with the parts that the weights ask for.
Options with_parts(Options options, const char* weights) {
  if (!weights) return options;
  auto archive = open_weights(weights);
  const Parts stored = parts_of(archive);
  if (stored.image != options.parts.image && (stored.image || !options.start))
    throw std::runtime_error(std::string("weights of a ") + (stored.image ? "fusion" : "lidar") +
                             " detector; choose that detector or other weights");
  const bool more = options.start;  // a new training may add parts
  options.parts.denoising = stored.denoising || (more && options.parts.denoising);
  options.parts.depth_gate = stored.depth_gate || (more && options.parts.depth_gate);
  return options;
}

Network make_network(const Options& options) {
  torch::manual_seed(options.seed);
  Network network(options.parts);
  network->to(best_device());
  // Only a training step turns them on.
  for (Tensor& parameter : network->parameters()) parameter.requires_grad_(false);
  return network;
}

/// While it lives, the parameters take part in the graph.
class ParameterGradients {
 public:
  explicit ParameterGradients(std::vector<Tensor> parameters) : parameters_(std::move(parameters)) {
    for (Tensor& parameter : parameters_) parameter.requires_grad_(true);
  }
  ParameterGradients(const ParameterGradients&) = delete;
  ParameterGradients& operator=(const ParameterGradients&) = delete;
  ~ParameterGradients() {
    for (Tensor& parameter : parameters_) parameter.requires_grad_(false);
  }

 private:
  std::vector<Tensor> parameters_;
};

}  // namespace

FusionDetector::FusionDetector(const Options& options, Network network)
    : options_(options),
      network_(std::move(network)),
      optimiser_(network_->parameters(),
                 torch::optim::AdamWOptions(1e-3).betas({0.9, 0.99}).weight_decay(kWeightDecay)) {
  options_.parts = network_->parts;
}

FusionDetector::FusionDetector(const Options& options, const char* weights)
    : FusionDetector(options, make_network(with_parts(options, weights))) {
  if (weights) load(weights);
}

const std::vector<MirageProposal>& FusionDetector::forward(const MirageSensorInput& input,
                                                           float score_threshold, bool keep_graph) {
  kept_logits_ = Tensor();
  kept_input_ = copy_input(input, options_.parts.image);
  kept_image_values_ = input.image ? std::size_t{3} * input.width * input.height : 0;
  at::set_num_threads(1);
  torch::AutoGradMode mode(keep_graph);
  if (keep_graph) {
    kept_input_.points.requires_grad_(true);
    if (kept_input_.image.defined()) kept_input_.image.requires_grad_(true);
  }
  const Tensor output = network_->forward(kept_input_);
  const Tensor logits = output.select(0, kLogit).reshape({-1});
  if (keep_graph) kept_logits_ = logits;

  const Tensor plain = output.detach().reshape({kOutputs, -1}).contiguous();
  const float* value = plain.data_ptr<float>();
  const std::int64_t cells = plain.size(1);
  proposals_.clear();
  proposal_cells_.clear();
  for (std::int64_t k = 0; k < cells; ++k) {
    const float logit = value[k];
    if (!(1 / (1 + std::exp(-logit)) > score_threshold)) continue;
    std::array<float, 6> box{};
    for (int c = 0; c < 6; ++c) box[c] = value[(kDx + c) * cells + k];
    proposals_.push_back({decode_box(k, box), {}, logit});
    proposal_cells_.push_back(k);
  }
  return proposals_;
}

void FusionDetector::backward(std::span<const float> d_logits, float* d_image, float* d_points) {
  if (!kept_logits_.defined())
    throw std::runtime_error(
        "backward needs a forward that kept its graph; call forward with keep_graph first");
  if (d_logits.size() != proposal_cells_.size())
    throw std::runtime_error("backward got " + std::to_string(d_logits.size()) + " logit gradients for " +
                             std::to_string(proposal_cells_.size()) + " proposals; give one for each");
  at::set_num_threads(1);
  Tensor seed = torch::zeros_like(kept_logits_);
  for (std::size_t i = 0; i < d_logits.size(); ++i) seed.data_ptr<float>()[proposal_cells_[i]] = d_logits[i];
  std::vector<Tensor> inputs = {kept_input_.points};
  if (kept_input_.image.defined()) inputs.push_back(kept_input_.image);
  const auto gradients = torch::autograd::grad({kept_logits_}, inputs, {seed}, true, false, true);
  const auto copy = [](const Tensor& gradient, const Tensor& like, float* out) {
    if (!out) return;
    const auto bytes = sizeof(float) * static_cast<std::size_t>(like.numel());
    if (bytes == 0) return;
    if (gradient.defined())
      std::memcpy(out, gradient.contiguous().data_ptr<float>(), bytes);
    else
      std::memset(out, 0, bytes);
  };
  copy(gradients[0], kept_input_.points, d_points);
  if (inputs.size() > 1)
    copy(gradients[1], kept_input_.image, d_image);
  else if (d_image)
    std::fill_n(d_image, kept_image_values_, 0.f);
}

std::array<float, 3> FusionDetector::train_step(std::span<const MirageSample> samples, float learning_rate) {
  if (samples.empty()) throw std::runtime_error("train_step got no samples; give at least one");
  kept_logits_ = Tensor();
  torch::AutoGradMode mode(true);
  const ParameterGradients on(network_->parameters());
  std::vector<Targets> targets;
  double positives = 0, boxed = 0;
  for (const MirageSample& sample : samples) {
    targets.push_back(make_targets({sample.boxes, static_cast<std::size_t>(sample.box_count)},
                                   {sample.ignore, static_cast<std::size_t>(sample.ignore_count)}));
    positives += targets.back().positives;
    boxed += targets.back().boxed;
  }
  const std::vector<Tensor> parameters = network_->parameters();
  std::vector<SampleResult> results(samples.size());
  for_each_sample(samples.size(), options_.threads, [&](std::size_t i) {
    const SensorTensors plain = copy_input(samples[i].input, options_.parts.image);
    const SensorTensors input = augment(plain, options_.seed, static_cast<std::uint64_t>(samples_seen_) + i);
    const LossTerms terms =
        detection_loss(training_pass(*network_, input, options_.bfloat16), targets[i], positives, boxed);
    results[i].loss = {terms.total.item<float>(), static_cast<float>(terms.score),
                       static_cast<float>(terms.box)};
    // Without the picture its branch gets no gradient: allow_unused.
    results[i].gradients = torch::autograd::grad({terms.total}, parameters, {}, {}, false, true);
  });
  samples_seen_ += static_cast<std::int64_t>(samples.size());
  // Summed in the samples' order, so that the number of threads changes nothing.
  std::array<float, 3> loss{};
  for (std::size_t k = 0; k < parameters.size(); ++k)
    parameters[k].mutable_grad() = torch::zeros_like(parameters[k]);
  for (const SampleResult& result : results) {
    for (std::size_t t = 0; t < loss.size(); ++t) loss[t] += result.loss[t];
    for (std::size_t k = 0; k < parameters.size(); ++k)
      if (result.gradients[k].defined()) parameters[k].mutable_grad().add_(result.gradients[k]);
  }
  if (!std::isfinite(loss[0]))
    throw std::runtime_error("the training loss is not finite; lower the learning rate");
  torch::nn::utils::clip_grad_norm_(network_->parameters(), kLargestGradient);
  for (auto& group : optimiser_.param_groups())
    static_cast<torch::optim::AdamWOptions&>(group.options()).lr(learning_rate);
  optimiser_.step();
  ++steps_;
  return loss;
}

MirageImageFeatures FusionDetector::image_features(const MirageSensorInput& input) {
  if (!options_.parts.image) throw std::runtime_error("this detector has no image features; use fusion");
  at::set_num_threads(1);
  const torch::NoGradGuard guard;
  const SensorTensors tensors = copy_input(input, true);
  if (!tensors.image.defined()) throw std::runtime_error("the input has no image; give one");
  const ReadFeatures found = network_->read_image(tensors);
  const Grid& grid = kGrids[0];
  kept_bev_ = torch::zeros({grid.rows * grid.columns});
  if (found.read.defined()) {
    const std::vector<std::int64_t>& cells = found.nearest[0].cells;  // the first rows are this scale's
    const auto count = static_cast<std::int64_t>(cells.size());
    kept_bev_.index_copy_(0, torch::tensor(cells),
                          found.read.narrow(0, 0, count).norm(2, 1).to(torch::kFloat));
  }
  // Of the grid's rows along x and columns along y: the interface has them the other way round.
  kept_bev_ = kept_bev_.view({grid.rows, grid.columns}).t().contiguous();
  const Tensor map = found.map.defined() ? found.map : network_->image(tensors.image.to(best_device()));
  kept_map_ = map.norm(2, 1).squeeze(0).to(torch::kCPU).to(torch::kFloat).contiguous();
  return {kept_map_.data_ptr<float>(),
          static_cast<std::int32_t>(kept_map_.size(1)),
          static_cast<std::int32_t>(kept_map_.size(0)),
          static_cast<float>(kImageStride),
          kept_bev_.data_ptr<float>(),
          static_cast<std::int32_t>(grid.rows),
          static_cast<std::int32_t>(grid.columns),
          static_cast<float>(grid.cell)};
}

void FusionDetector::save(const std::string& file, bool with_optimiser) {
  torch::serialize::OutputArchive archive;
  archive.write("format", c10::IValue(std::string(kFormat)));
  archive.write("with_image", c10::IValue(options_.parts.image));
  archive.write("denoising", c10::IValue(options_.parts.denoising));
  archive.write("depth_gate", c10::IValue(options_.parts.depth_gate));
  torch::serialize::OutputArchive network;
  network_->save(network);
  archive.write("network", network);
  archive.write("with_optimiser", c10::IValue(with_optimiser));
  if (with_optimiser) {
    archive.write("steps", c10::IValue(steps_));
    archive.write("samples_seen", c10::IValue(samples_seen_));
    torch::serialize::OutputArchive optimiser;
    optimiser_.save(optimiser);
    archive.write("optimiser", optimiser);
  }
  // Through memory: LibTorch's file writer aborts the process when its destructor meets a full disk.
  std::ostringstream bytes;
  archive.save_to(bytes);
  write_file(file, bytes.str());
}

void FusionDetector::load(const std::string& file) {
  torch::serialize::InputArchive archive = open_weights(file), network;
  archive.read("network", network);
  load_network(network, parts_of(archive));
  if (options_.start) return;
  c10::IValue value;
  archive.read("with_optimiser", value);
  if (!value.toBool()) return;
  archive.read("steps", value);
  steps_ = value.toInt();
  archive.read("samples_seen", value);
  samples_seen_ = value.toInt();
  torch::serialize::InputArchive optimiser;
  archive.read("optimiser", optimiser);
  optimiser_.load(optimiser);
}

void FusionDetector::load_network(torch::serialize::InputArchive& archive, const Parts& stored) {
  Network read(stored);
  read->to(best_device());
  std::map<std::string, std::vector<std::int64_t>> shapes;
  for (const auto& item : read->named_parameters()) shapes[item.key()] = item.value().sizes().vec();
  read->load(archive);
  if (options_.parts.image && !stored.image)
    for (ContinuousFusion& fuse : network_->fuse) fuse->silence();
  const torch::NoGradGuard guard;
  auto ours = network_->named_parameters();
  for (const auto& item : read->named_parameters()) {
    if (item.value().sizes().vec() != shapes[item.key()])
      throw std::runtime_error("weights of another network; train anew with mirage train");
    if (!torch::isfinite(item.value()).all().item<bool>())
      throw std::runtime_error(
          "weights that are not finite; restore the file, or train anew with mirage train");
    ours[item.key()].copy_(item.value());
  }
}

}  // namespace mirage::fusion
