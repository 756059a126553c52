// What defences that stand around a detector share.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "detection/detector.h"

namespace mirage {

/// A detector within: whatever a defence does not override is the inner detector's own. What it hands on in
/// forward() must live until backward() is done.
class DetectorAround : public Detector {
 public:
  explicit DetectorAround(std::unique_ptr<Detector> inner) : inner_(std::move(inner)) {}

  std::string name() const override { return inner_->name(); }
  std::array<double, 4> region() const override { return inner_->region(); }
  Capabilities capabilities() const override { return inner_->capabilities(); }
  SensorGradient backward(std::span<const double> d_logits) override { return inner_->backward(d_logits); }
  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    return inner_->train_step(samples, learning_rate);
  }
  std::uint64_t weights_version() const override { return inner_->weights_version(); }
  void save(const std::filesystem::path& file, bool with_optimiser) override {
    inner_->save(file, with_optimiser);
  }
  ImageFeatures image_features(const SensorView& input) override { return inner_->image_features(input); }

 protected:
  std::unique_ptr<Detector> inner_;
};

/// What counts for a place of which a detector says nothing.
inline constexpr double kSilentLogit = -8;

/// The threshold that lets a detector say all that is above kSilentLogit, and no less than it is asked for.
inline double speaking_score(double asked) {
  return std::min(asked, Detection{BevBox(), kSilentLogit}.score());
}

/// Whether two boxes are of one vehicle: IoU above 0.1, as non-maximum suppression has it.
inline bool same_place(const BevBox& a, const BevBox& b) {
  constexpr double kOverlap = 0.1;
  const double reach = (std::hypot(a.length, a.width) + std::hypot(b.length, b.width)) / 2;
  return std::hypot(a.x - b.x, a.y - b.y) < reach && iou(a, b) > kOverlap;
}

}  // namespace mirage
