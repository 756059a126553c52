// Defences that wrap a detector, and their common base.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "detection/car_in_picture.h"
#include "detection/detector.h"
#include "geometry/box.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// A wrapper of a detector: methods that it does not override are the inner detector's. The view that it
/// hands on in forward() must live until backward() is done.
class DetectorWrapper : public Detector {
 public:
  /// Wraps `inner`, which is not null.
  explicit DetectorWrapper(std::unique_ptr<Detector> inner) : inner_(std::move(inner)) {}

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

/// The logit at a place where a detector has no proposal.
inline constexpr double kNoDetectionLogit = -8;

/// The score threshold at which a detector reports all proposals above kNoDetectionLogit, and all over
/// `threshold`.
inline double reporting_threshold(double threshold) {
  return std::min(threshold, Detection{BevBox(), kNoDetectionLogit}.score());
}

/// Whether two boxes are of one vehicle: IoU above 0.1, as non-maximum suppression has it.
inline bool same_place(const BevBox& a, const BevBox& b) {
  constexpr double kOverlap = 0.1;
  const double reach = (std::hypot(a.length, a.width) + std::hypot(b.length, b.width)) / 2;
  return horizontal_distance(a, b) < reach && iou(a, b) > kOverlap;
}

// A ceiling as a defence: a detector that ignores everything above a height over the road.
//
// An object strapped to a roof is above it; the features that tell a car from other things are below. So
//
//     returns   higher than `height` over the road there (RoadSurface) are left out;
//     pixels    whose line of sight is nowhere below a level plane at that height, within the searched region
//               ahead, are black: with the camera near that height, those above the horizon. The same
//               holds for other cameras, along their own headings.
//
// A roof of 1.5 m under a ceiling of 1.6 m leaves an object of 0.7 m its lowest 10 cm, in both sensors,
// whatever it looks like. An attacker who knows the defence has its gradient: that of visible data is
// unchanged, hidden data have none. A return that rises through the ceiling is a step, like one that leaves
// the object.

/// `height`: m over the road; `unit_height`: of the LiDAR unit over it, which places the level plane.
/// Training sees the same input.
std::unique_ptr<Detector> under_ceiling(std::unique_ptr<Detector> inner, double height, double unit_height);

// Bodies and shadows as a defence: proposals are cross-checked with solid bodies in the sweep, found without
// any network. In logits:
//
//     a body stands there      its proposals, and the body's own box, are raised by kBodyLift
//                              up to kBodyLogit;
//                              beyond, with the slope kSaturatedSlope: the better of two stays the better
//     rays go through there    a proposal above kThroughLogit sinks to it, but for the same slope:
//                              five rays or more,
//                              and more than are stopped
//
// An object on a roof changes neither bodies nor the rays below it. So an attacker who knows the defence has
// to push a car's logit further, by kBodyLift, and has the gradient for it.

/// A score of 0.38: the body counts as found at a threshold of 0.3, and ranks behind the detector's own
/// finds, since every second body of a car's size is not a car (look-alikes, vans, garden objects).
inline constexpr double kBodyLogit = -0.5;
inline constexpr double kBodyLift = 4, kSaturatedSlope = 0.05, kThroughLogit = -2;
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

/// `linear` through 8-bit sRGB and baseline JPEG with 4:2:0 chroma at `quality` (1–100), back to
/// scene-linear. Failure if the library fails.
ImageF jpeg_round_trip(const ImageF& linear, int quality);

/// `inner` behind JPEG: its forward, image features and training see every camera's picture compressed.
std::unique_ptr<Detector> behind_jpeg(std::unique_ptr<Detector> inner, int quality);

// Solid bodies in a sweep, found without any network.
//
// Bodies are found by returns from 0.3 to 1.4 m above the road and by their shadow, the space behind them
// that no ray reaches. So a car hidden from a detector still is a body (Hau et al., "Using 3D Shadows to
// Detect Object Hiding Attacks on Autonomous Vehicle Perception", 2022), and where rays pass at the height of
// a car's body there is no car, whatever a detector reports (as local objectness does: Xiao et al.,
// "Exorcising Wraith", USENIX Security 2023).

/// The road as a plane, by the lowest return of each square metre, and heights around it.
class RoadSurface {
 public:
  explicit RoadSurface(std::span<const LidarPoint> points);
  /// z (m, `velo`): the lowest return within the square metre and its neighbours, or the plane if that is
  /// more than 0.4 m away (a roof, or no return of the road).
  double height(double x, double y) const;

 private:
  double plane(double x, double y) const { return plane_.x() + plane_.y() * x + plane_.z() * y; }
  LowestReturns lowest_;
  Vec3d plane_ = Vec3d(-1.7, 0, 0);  ///< z = a + b x + c y
};

/// Rays at a box that stands on the road, at the height of a car's body.
struct RayCount {
  int stopped = 0;  ///< returns in the box
  int passed = 0;   ///< rays through its inner part that go on for half a metre or more
};

/// Bodies and rays of one sweep; the unit is at the origin of `velo`.
class BodyEvidence {
 public:
  /// `points`: the searched part of the sweep (points_in_view).
  explicit BodyEvidence(std::span<const LidarPoint> points);

  RayCount rays(const BevBox& box) const;
  /// Things of a car's size, up to 45 m away, that stop nine of ten rays or more, each with the box of a car
  /// that fits its visible part: rectangles by closeness (Zhang et al., "Efficient L-Shape Fitting for
  /// Vehicle Detection Using Laser Scanners", 2017), extended away from the unit to KITTI's mean car where
  /// less is visible.
  std::vector<BevBox> bodies() const;

 private:
  std::span<const LidarPoint> points_;
  RoadSurface road_;
};

}  // namespace mirage
