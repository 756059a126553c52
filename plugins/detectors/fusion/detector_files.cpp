// What of the detector's state its files hold.
#include <optional>
#include <stdexcept>

#include "fusion_detector.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

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
  torch::serialize::OutputArchive archive = begin_weights(options_.parts);
  archive.write("camera_frozen", c10::IValue(camera_frozen_));
  archive.write("lidar_frozen", c10::IValue(lidar_frozen_));
  archive.write("trunk_frozen", c10::IValue(trunk_frozen_));
  torch::serialize::OutputArchive network;
  network_->save(network);
  archive.write("network", network);
  archive.write("with_optimiser", c10::IValue(with_optimiser));
  if (with_optimiser) {
    archive.write("steps", c10::IValue(steps_));
    archive.write("samples_seen", c10::IValue(samples_seen_));
    archive.write("peak_rate", c10::IValue(peak_rate_));
    torch::serialize::OutputArchive optimiser;
    optimiser_->save(optimiser);
    archive.write("optimiser", optimiser);
    for (std::size_t k = 0; k < start_.size(); ++k) archive.write(start_name(k), start_[k]);
  }
  write_weights(archive, file);
}

void FusionDetector::load(const std::string& file) {
  if (options_.start && name_of(options_.parts) == "camera" && !is_weights_file(file)) {
    read_coco(*network_->camera, file);
    trunk_frozen_ = !options_.joint;
    return;
  }
  copy_network(file, *network_);
  torch::serialize::InputArchive archive = open_weights(file);
  c10::IValue value;
  camera_frozen_ = archive.try_read("camera_frozen", value) && value.toBool();
  lidar_frozen_ = archive.try_read("lidar_frozen", value) && value.toBool();
  trunk_frozen_ = archive.try_read("trunk_frozen", value) && value.toBool() && !options_.joint;
  // A second stage that is put on a first one learns alone.
  if (options_.parts.second && !parts_of(archive).second) camera_frozen_ = lidar_frozen_ = !options_.joint;
  start_optimiser();
  if (options_.start) return;
  archive.read("with_optimiser", value);
  if (!value.toBool()) return;
  archive.read("steps", value);
  steps_ = value.toInt();
  archive.read("samples_seen", value);
  samples_seen_ = value.toInt();
  if (archive.try_read("peak_rate", value)) peak_rate_ = value.toDouble();
  torch::serialize::InputArchive optimiser;
  archive.read("optimiser", optimiser);
  optimiser_->load(optimiser);
  for (std::size_t k = 0; k < start_.size(); ++k) archive.read(start_name(k), start_[k]);
}

void FusionDetector::take_over(const std::string& file, const std::string& name) {
  auto archive = open_weights(file);
  if (name_of(parts_of(archive)) != name)
    throw std::runtime_error(file + ": not the weights of such a " + name + " detector; check --" + name);
  copy_network(file, *network_);
}

}  // namespace mirage::fusion
