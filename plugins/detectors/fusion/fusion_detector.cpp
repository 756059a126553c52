#include "fusion_detector.h"

#include <dlfcn.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "../../torch_threads.h"
#include "base/files.h"
#include "base/sizes.h"
#include "joins.h"
#include "region.h"
#include "scopes.h"
#include "sensor_tensors.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kWeightDecay = 0.01;

/// The options with the parts that the weights ask for.
Options with_parts(Options options, const char* weights) {
  if (!weights) return options;
  const std::string architecture = name_of(options.parts);
  if (architecture == "camera" && options.start && !is_weights_file(weights)) return options;  // COCO's
  const Parts stored = parts_of(open_weights(weights));
  const std::string name = name_of(stored);
  const bool from_lidar = options.start && name == "lidar" && options.parts.lidar;
  const bool from_first_stage = options.start && name == "fusion" && options.parts.second;
  if (name != architecture && !from_lidar && !from_first_stage)
    throw std::runtime_error("weights of a " + name + " detector; choose that detector or other weights");
  const Parts requested = options.parts;
  if (name == architecture) options.parts = stored;
  // A new training may add parts.
  options.parts.denoising = stored.denoising || (options.start && requested.denoising);
  options.parts.depth_gate = stored.depth_gate || (options.start && requested.depth_gate);
  return options;
}

/// oneDNN keeps the convolutions that it compiled for the last 1024 sizes; passes over windows have tens of
/// thousands. Once its store is full, each new one searches all of it for the oldest.
void keep_compiled_convolutions() {
  constexpr int kKept = 1 << 16;
  static std::once_flag once;
  std::call_once(once, [] {
    void* library = dlopen("libdnnl.so.2", RTLD_LAZY | RTLD_NOLOAD);  // LibTorch's; has no header here
    if (!library) return;
    if (void* set = dlsym(library, "dnnl_set_primitive_cache_capacity"))
      reinterpret_cast<int (*)(int)>(set)(kKept);
  });
}

Network make_network(const Options& options) {
  keep_compiled_convolutions();
  torch::manual_seed(options.seed);
  Network network(options.parts);
  network->to(torch::cuda::is_available() ? torch::kCUDA : torch::kCPU);
  // Only a training step turns them on.
  for (Tensor& parameter : network->parameters()) parameter.requires_grad_(false);
  if (options.precision == Precision::double_) network->to(torch::kDouble);
  return network;
}

// The detector's state in its files.

constexpr const char *kCamera = "camera", *kLidar = "lidar", *kTrunk = "trunk";  // words of "frozen"

/// In a checkpoint: the name of the k-th learning weight at the training's start.
std::string start_name(std::size_t k) {
  return "start" + std::to_string(k);
}

}  // namespace

FusionDetector::FusionDetector(const Options& options, Network network,
                               std::shared_ptr<CleanActivationCache> clean_frames)
    : options_(options), network_(std::move(network)), clean_frames_(std::move(clean_frames)) {
  options_.parts = network_->parts;
  if (!clean_frames_)
    clean_frames_ = std::make_shared<CleanActivationCache>(network_, options_.clean_memory,
                                                           options_.precision == Precision::bfloat16);
  start_optimiser();
}

FusionDetector::FusionDetector(const Options& options, const char* weights)
    : FusionDetector(options, make_network(with_parts(options, weights)), nullptr) {
  if (weights) load(weights);
  if (weights && !options_.start) return;
  if (!options_.lidar.empty()) load_branch(options_.lidar, "lidar");
  if (!options_.camera.empty()) load_branch(options_.camera, "camera");
  camera_frozen_ = !options_.joint && (camera_frozen_ || !options_.camera.empty());
  lidar_frozen_ = !options_.joint && (lidar_frozen_ || !options_.lidar.empty());
  start_optimiser();
}

void FusionDetector::start_optimiser() {
  start_.clear();
  if (options_.keep_start > 0)
    for (const Tensor& parameter : learning()) start_.push_back(parameter.detach().clone());
  optimiser_ = std::make_unique<torch::optim::AdamW>(
      learning(), torch::optim::AdamWOptions(1e-3).betas({0.9, 0.99}).weight_decay(kWeightDecay));
}

bool FusionDetector::learns(const std::string& parameter) const {
  if (!parameter.starts_with("camera."))
    return parameter.starts_with("join.") || parameter.starts_with("second.") || lidar_learns();
  const bool trunk = !parameter.starts_with(options_.heads ? "camera.head" : "camera.mask_");
  return camera_learns() && !(trunk && trunk_frozen_);
}

std::vector<Tensor> FusionDetector::learning() const {
  std::vector<Tensor> parameters;
  for (const auto& item : network_->named_parameters())
    if (learns(item.key())) parameters.push_back(item.value());
  return parameters;
}

std::uint32_t FusionDetector::capabilities() const {
  const Parts& parts = options_.parts;
  std::uint32_t flags = parts.lidar ? MIRAGE_READS_POINTS | MIRAGE_FINDS_BEV : MIRAGE_FINDS_PICTURE;
  if (reads_image()) flags |= MIRAGE_READS_IMAGE;
  if (parts.lidar) flags |= MIRAGE_KNOWS_PRESENCE;
  return flags | MIRAGE_KNOWS_CHANGES;
}

const std::vector<MirageProposal>& FusionDetector::forward(const MirageSensorInput& input,
                                                           float score_threshold, bool keep_graph) {
  kept_logits_ = Tensor();
  local_.reset();
  forward_input_ = copy_input(input, reads_image());
  take_watched(forward_input_, keep_graph);
  forward_input_ = in_type_of(*network_, forward_input_);
  kept_image_values_ = input.image ? std::size_t{3} * as_size(input.width) * as_size(input.height) : 0;
  set_torch_threads(1);
  torch::AutoGradMode mode(keep_graph);
  const Bfloat16 rounded(options_.precision == Precision::bfloat16);
  if (keep_graph) {
    forward_input_.points.requires_grad_(true);
    if (forward_input_.image.defined()) forward_input_.image.requires_grad_(true);
    if (forward_input_.masses.defined()) forward_input_.masses.requires_grad_(true);
  }
  if (!options_.parts.lidar) {
    const CameraOutput seen = network_->see(forward_input_);
    if (!seen.defined()) throw std::runtime_error("the input has no image; give one");
    if (keep_graph) kept_logits_ = seen.logits;
    propose(seen, score_threshold);
    return proposals_;
  }
  const Tensor output = network_->forward(forward_input_).to(forward_input_.points.scalar_type());
  if (keep_graph) kept_logits_ = output.select(0, kLogit).reshape({-1});
  propose(output, score_threshold);
  return proposals_;
}

void FusionDetector::propose(std::span<const float> logits, float score_threshold,
                             const std::function<MirageProposal(std::int64_t)>& proposal) {
  proposals_.clear();
  proposal_cells_.clear();
  for (std::size_t k = 0; k < logits.size(); ++k) {
    // A car with an invalid logit would be missed silently.
    if (!std::isfinite(logits[k]))
      throw std::runtime_error(
          "the network gave a logit that is not finite; check its weights and the input");
    if (!(1 / (1 + std::exp(-logits[k])) > score_threshold)) continue;
    proposal_cells_.push_back(static_cast<std::int64_t>(k));
    proposals_.push_back(proposal(proposal_cells_.back()));
    proposals_.back().logit = logits[k];
  }
}

void FusionDetector::propose(const Tensor& output, float score_threshold) {
  const Tensor plain = output.detach().to(torch::kFloat).contiguous();
  const float* values = plain.data_ptr<float>();  // logits are the first channel
  propose({values, as_size(kCellsX * kCellsY)}, score_threshold, [&](std::int64_t cell) {
    return MirageProposal{decode_box(values, cell), {}, 0};
  });
}

void FusionDetector::propose(const CameraOutput& seen, float score_threshold) {
  const Tensor logits = seen.logits.detach().to(torch::kFloat).contiguous(),
               boxes = seen.boxes.detach().to(torch::kFloat).contiguous();
  propose({logits.data_ptr<float>(), as_size(logits.numel())}, score_threshold, [&](std::int64_t place) {
    const float* box = boxes.data_ptr<float>() + 4 * place;
    return MirageProposal{{}, {box[0], box[1], box[2], box[3]}, 0};
  });
}

void FusionDetector::backward(std::span<const float> d_logits, float* d_image, float* d_points) {
  if (!kept_logits_.defined() && !local_)
    throw std::runtime_error(
        "backward needs a forward that kept its graph; call forward with keep_graph first");
  if (d_logits.size() != proposal_cells_.size())
    throw std::runtime_error("backward got " + std::to_string(d_logits.size()) + " logit gradients for " +
                             std::to_string(proposal_cells_.size()) + " proposals; give one for each");
  set_torch_threads(1);
  Tensor seed = torch::zeros({local_ ? local_->logit_count() : kept_logits_.numel()});
  for (std::size_t i = 0; i < d_logits.size(); ++i) seed.data_ptr<float>()[proposal_cells_[i]] = d_logits[i];
  // Values without a gradient are zero.
  const std::int64_t points = local_ ? local_->input_size().second : forward_input_.points.size(0);
  if (d_image) std::fill_n(d_image, kept_image_values_, 0.f);
  if (d_points) std::fill_n(d_points, 4 * points, 0.f);
  if (local_) return backward_changed(seed, d_image, d_points);
  std::vector<Tensor> inputs = {forward_input_.points};
  if (forward_input_.image.defined()) inputs.push_back(forward_input_.image);
  const std::size_t of_masses = inputs.size();
  if (forward_input_.masses.defined()) inputs.push_back(forward_input_.masses);
  const auto gradients =
      torch::autograd::grad({kept_logits_}, inputs, {seed.to(kept_logits_.scalar_type())}, true, false, true);
  const auto copy = [](const Tensor& gradient, float* out) {
    if (!out || !gradient.defined()) return;
    const Tensor values = gradient.to(torch::kFloat).contiguous();
    std::copy_n(values.data_ptr<float>(), values.numel(), out);
  };
  copy(gradients[0], d_points);
  if (of_masses < inputs.size()) keep_presence(gradients[of_masses], forward_input_.masses.size(0));
  if (forward_input_.image.defined()) copy(gradients[1], d_image);
}

void FusionDetector::watch(const float* places, std::int64_t count) {
  watched_ = count == 0 ? Tensor() : torch::from_blob(const_cast<float*>(places), {count, 4}).clone();
}

void FusionDetector::take_watched(SensorTensors& input, bool keep_graph) {
  presence_.clear();
  if (keep_graph && watched_.defined() && options_.parts.lidar) {
    input.watched = watched_;
    input.masses = torch::zeros({watched_.size(0)});
  }
  watched_ = Tensor();
}

void FusionDetector::keep_presence(const Tensor& masses, std::int64_t count) {
  presence_.assign(as_size(count), 0.f);
  if (!masses.defined()) return;
  const Tensor values = masses.to(torch::kFloat).contiguous();
  std::copy_n(values.data_ptr<float>(), count, presence_.begin());
}

MirageImageFeatures FusionDetector::image_features(const MirageSensorInput& input) {
  if (!reads_image()) throw std::runtime_error("this detector has no image features; use one with a camera");
  set_torch_threads(1);
  const torch::NoGradGuard guard;
  SensorTensors tensors = in_type_of(*network_, copy_input(input, true));
  if (!tensors.image.defined()) throw std::runtime_error("the input has no image; give one");
  tensors.camera = network_->see(tensors);
  const Tensor& map = tensors.camera.features;
  const Grid& grid = kGrids[0];
  kept_bev_ = torch::zeros({grid.rows, grid.columns});
  if (options_.parts.image) {
    const ReadFeatures features = network_->read_image(tensors);
    if (features.read.defined()) {
      const std::vector<std::int64_t>& cells = features.nearest[0].cells;  // the first rows are this scale's
      const auto count = static_cast<std::int64_t>(cells.size());
      kept_bev_.view({-1}).index_copy_(0, torch::tensor(cells),
                                       features.read.narrow(0, 0, count).norm(2, 1).to(torch::kFloat));
    }
  } else if (options_.parts.painted) {
    kept_bev_ = torch::avg_pool2d(painted_voxels(tensors).narrow(1, 0, 1), 2)[0][0];
  }
  // Of the grid's rows along x and columns along y: the interface has them the other way round.
  kept_bev_ = kept_bev_.t().contiguous();
  kept_map_ = map.norm(2, 1).squeeze(0).to(torch::kCPU).to(torch::kFloat).contiguous();
  return {kept_map_.data_ptr<float>(),
          static_cast<std::int32_t>(kept_map_.size(1)),
          static_cast<std::int32_t>(kept_map_.size(0)),
          static_cast<float>(kFeatureStride),
          kept_bev_.data_ptr<float>(),
          static_cast<std::int32_t>(grid.rows),
          static_cast<std::int32_t>(grid.columns),
          static_cast<float>(grid.cell)};
}

void FusionDetector::save(const std::string& file, bool with_optimiser) {
  WeightsWriter writer = begin_weights(*network_);
  std::string frozen;
  for (const auto& [word, is_frozen] :
       {std::pair(kCamera, camera_frozen_), {kLidar, lidar_frozen_}, {kTrunk, trunk_frozen_}})
    if (is_frozen) frozen.append(frozen.empty() ? "" : " ").append(word);
  if (!frozen.empty()) writer.state("frozen", frozen);
  if (with_optimiser) {
    writer.add("training.steps", torch::tensor(steps_, torch::kLong));
    writer.add("training.samples_seen", torch::tensor(samples_seen_, torch::kLong));
    writer.add("training.peak_rate", torch::tensor(peak_rate_, torch::kDouble));
    add_state(writer, *optimiser_);
    for (std::size_t k = 0; k < start_.size(); ++k) writer.add(start_name(k), start_[k]);
  } else if (!start_.empty()) {
    auto start = start_.begin();
    for (const auto& item : network_->named_parameters())
      if (learns(item.key())) writer.add(item.key(), item.value().lerp(*start++, options_.keep_start));
  }
  writer.write(file);
}

void FusionDetector::load(const std::string& file) {
  if (options_.start && name_of(options_.parts) == "camera" && !is_weights_file(file)) {
    read_coco(*network_->camera, file);
    trunk_frozen_ = !options_.joint;
    return;
  }
  copy_network(file, *network_);
  const WeightsFile weights = open_weights(file);
  camera_frozen_ = has_word(weights, "frozen", kCamera);
  lidar_frozen_ = has_word(weights, "frozen", kLidar);
  trunk_frozen_ = has_word(weights, "frozen", kTrunk) && !options_.joint;
  // A new second stage on a trained first one learns alone.
  if (options_.parts.second && !parts_of(weights).second) camera_frozen_ = lidar_frozen_ = !options_.joint;
  start_optimiser();
  if (options_.start || !weights.holds("training.steps")) return;
  steps_ = weights.tensor("training.steps", {}).item<std::int64_t>();
  samples_seen_ = weights.tensor("training.samples_seen", {}).item<std::int64_t>();
  peak_rate_ = weights.tensor("training.peak_rate", {}).item<double>();
  read_state(weights, *optimiser_);
  for (std::size_t k = 0; k < start_.size(); ++k)
    start_[k].copy_(weights.tensor(start_name(k), start_[k].sizes()));
}

void FusionDetector::load_branch(const std::string& file, const std::string& name) {
  if (name_of(parts_of(open_weights(file))) != name)
    throw std::runtime_error(file + ": not the weights of such a " + name + " detector; check --" + name);
  copy_network(file, *network_);
}

// The detector's passes over an input that is mostly a clean one (local_network.h).

const char* FusionDetector::why_whole() const {
  return options_.clean_memory == 0 ? "no memory was given to it for clean frames"
                                    : CleanActivationCache::why_whole(options_.parts);
}

const std::vector<MirageProposal>& FusionDetector::forward_changed(const MirageSensorInput& input,
                                                                   const MirageChange& change,
                                                                   float score_threshold, bool keep_graph) {
  const bool picture = input.image && input.width > 0 && input.height > 0;
  const bool same_picture =
      !reads_image() ||
      (picture == (change.clean->image != nullptr) &&
       (!picture || (input.width == change.clean->width && input.height == change.clean->height)));
  if (*why_whole() != '\0' || !same_picture || (!options_.parts.lidar && !picture))
    return forward(input, score_threshold, keep_graph);
  kept_logits_ = Tensor();
  local_.reset();
  forward_input_ = {};
  kept_image_values_ = input.image ? std::size_t{3} * as_size(input.width) * as_size(input.height) : 0;
  set_torch_threads(1);
  SensorTensors now = view_input(input, reads_image());
  take_watched(now, keep_graph);
  auto local = std::make_unique<LocalNetwork>(
      network_, clean_frames_->of(change.key, [&] { return copy_input(*change.clean, reads_image()); }), now,
      Window{change.top, change.left, change.bottom, change.right}, options_.locality);
  if (options_.parts.lidar)
    propose(local->output(), score_threshold);
  else
    propose(local->seen(), score_threshold);
  if (keep_graph) local_ = std::move(local);
  return proposals_;
}

void FusionDetector::backward_changed(const Tensor& d_logits, float* d_image, float* d_points) {
  const LocalNetwork::Gradient gradient = local_->backward(d_logits);
  const std::int64_t width = local_->input_size().first;
  if (gradient.masses.defined()) keep_presence(gradient.masses, gradient.masses.size(0));
  if (d_image && gradient.image.defined()) {
    const Window& at = gradient.pixels;
    const Tensor image = gradient.image.to(torch::kFloat).contiguous();
    const float* row = image.data_ptr<float>();
    for (std::int64_t v = at.top; v < at.bottom; ++v, row += 3 * at.columns())
      std::copy_n(row, 3 * at.columns(), d_image + 3 * (v * width + at.left));
  }
  if (!d_points) return;
  const Tensor of_points = gradient.of_points.to(torch::kFloat);
  const float* row = of_points.data_ptr<float>();
  for (const std::int64_t point : gradient.points) {
    std::copy_n(row, 4, d_points + 4 * point);
    row += 4;
  }
}

}  // namespace mirage::fusion
