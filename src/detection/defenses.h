// What defences that stand around a detector share.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
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

// A ceiling as a defence: a detector that looks at nothing above a height over the road.
//
// What an attacker straps to a roof stands above it; what tells a car from everything else stands below. So
//
//     returns   higher than `height` over the road there (RoadSurface) are left out;
//     pixels    whose line of sight is nowhere below a level plane at that height, within the searched region
//               ahead, are black: with the camera near that height, what lies above the horizon.
//
// A roof of 1.5 m under a ceiling of 1.6 m leaves an object of 0.7 m its lowest 10 cm, in both sensors,
// whatever it looks like. An attacker who knows the defence has its gradient: what is left passes as it is,
// what is hidden has none, and a return that rises through the ceiling is a step, as one that leaves the
// object is.

/// `height`: m over the road; `unit_height`: of the LiDAR unit over it, which places the level plane.
/// Training sees the same.
std::unique_ptr<Detector> under_ceiling(std::unique_ptr<Detector> inner, double height, double unit_height);

// Bodies and shadows as a defence: what a detector says is held against what the sweep says of solid bodies
// without any network (body_evidence.h). In logits:
//
//     a body stands there      its proposals, and the body's own box, are raised by kBodyLift up to
//     kBodyLogit;
//                              beyond, with the slope kBodySlope: the better of two stays the better
//     rays go through there    a proposal above kThroughLogit sinks to it, but for the same slope: five rays
//     or
//                              more, and more than are stopped
//
// An object on a roof changes neither bodies nor the rays below it, so all that an attacker who knows the
// defence can do is to push a car's logit further, by kBodyLift; the gradient that says how is there.

/// A score of 0.38: such a body counts as found where 0.3 is asked for, and comes behind what the detector
/// finds by itself, since every other body of a car's size is none (look-alikes, vans, what stands in
/// gardens).
inline constexpr double kBodyLogit = -0.5;
inline constexpr double kBodyLift = 4, kBodySlope = 0.05, kThroughLogit = -2;
inline constexpr int kThroughRays = 5;

/// FieldError naming defense if `detector` finds no boxes from above or reads no returns. Training and saving
/// are those of `detector`.
std::unique_ptr<Detector> with_shadows(std::unique_ptr<Detector> detector);

// JPEG as a defence (Dziugaite et al., 2016): a detector sees the picture compressed and decompressed.
//
// Forward it is plain libjpeg-turbo. Backward it is straight-through: the gradient with respect to the
// compressed picture is taken for that of the picture itself (BPDA; Athalye et al., ICML 2018), because the
// derivative of rounding is zero almost everywhere and would hide the defence from its attacker.

/// A JPEG file of scene-linear RGB: 8-bit sRGB, baseline, 4:2:0 chroma, `quality` 1–100. Failure if the
/// library fails.
std::string encode_jpeg(const ImageF& linear, int quality);

/// Through 8-bit sRGB and baseline JPEG with 4:2:0 chroma at `quality` (1–100), back to scene-linear. Failure
/// if the library fails.
ImageF jpeg_round_trip(const ImageF& linear, int quality);

/// `inner` behind JPEG: its forward, image features and training see the compressed picture.
std::unique_ptr<Detector> behind_jpeg(std::unique_ptr<Detector> inner, int quality);

}  // namespace mirage
