// What of the detector's state its files hold.
#include <optional>
#include <stdexcept>

#include "fusion_detector.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr const char *kCamera = "camera", *kLidar = "lidar", *kTrunk = "trunk";  // words of "frozen"

/// In a checkpoint: of the k-th learning weight, what the training started from.
std::string start_name(std::size_t k) {
  return "start" + std::to_string(k);
}

}  // namespace

/// The weights as a training's result has them, for as long as it lives.
class FusionDetector::MixedWithStart {
 public:
  explicit MixedWithStart(FusionDetector& detector) : parameters_(detector.learning()) {
    const torch::NoGradGuard guard;
    if (detector.start_.empty()) parameters_.clear();
    for (std::size_t k = 0; k < parameters_.size(); ++k) {
      learned_.push_back(parameters_[k].detach().clone());
      parameters_[k].lerp_(detector.start_[k], detector.options_.keep_start);
    }
  }
  ~MixedWithStart() {
    const torch::NoGradGuard guard;
    for (std::size_t k = 0; k < parameters_.size(); ++k) parameters_[k].copy_(learned_[k]);
  }
  MixedWithStart(const MixedWithStart&) = delete;
  MixedWithStart& operator=(const MixedWithStart&) = delete;

 private:
  std::vector<Tensor> parameters_, learned_;
};

void FusionDetector::save(const std::string& file, bool with_optimiser) {
  std::optional<MixedWithStart> mixed;
  if (!with_optimiser) mixed.emplace(*this);
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
  // A second stage that is put on a first one learns alone.
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

void FusionDetector::take_over(const std::string& file, const std::string& name) {
  if (name_of(parts_of(open_weights(file))) != name)
    throw std::runtime_error(file + ": not the weights of such a " + name + " detector; check --" + name);
  copy_network(file, *network_);
}

}  // namespace mirage::fusion
