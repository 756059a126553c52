// What a sweep says of solid bodies without any network: which car-sized things stop its rays, and which
// places its rays go through.
//
// An object on a roof changes neither: bodies are told by returns from 0.3 to 1.4 m above the road and by the
// space behind them that no ray reaches, their shadow. So a car that a detector was made to miss still stands
// there as a body (Hau et al., "Using 3D Shadows to Detect Object Hiding Attacks on Autonomous Vehicle
// Perception", 2022), and where rays go through at the height of a car's body there is none, whatever a
// detector was made to see (as local objectness does: Xiao et al., "Exorcising Wraith", USENIX Security
// 2023).
#pragma once

#include <span>
#include <vector>

#include "geometry/box.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// The road as a plane, by the lowest return of each square metre, and heights around it.
class RoadSurface {
 public:
  explicit RoadSurface(std::span<const LidarPoint> points);
  /// z (m, `velo`): the lowest return within the square metre and those around it, the plane where that lies
  /// further than 0.4 m from it (a roof, or nothing seen of the road).
  double height(double x, double y) const;

 private:
  double plane(double x, double y) const { return plane_.x() + plane_.y() * x + plane_.z() * y; }
  std::vector<float> lowest_;
  Vec3d plane_ = Vec3d(-1.7, 0, 0);  ///< z = a + b x + c y
};

/// Rays and a box that stands on the road, at the height of a car's body.
struct RayCount {
  int stopped = 0;  ///< returns in the box
  int passed = 0;   ///< rays through its inner part that go on for half a metre or more
};

/// What one sweep says; the unit stands at the origin of `velo`.
class BodyEvidence {
 public:
  /// `points`: of the part of the sweep that is searched (points_in_view).
  explicit BodyEvidence(std::span<const LidarPoint> points);

  RayCount rays(const BevBox& box) const;
  /// Things of a car's size, up to 45 m away, that stop nine of ten rays or more, each with the box of a car
  /// that shows what is seen of it: rectangles by closeness (Zhang et al., "Efficient L-Shape Fitting for
  /// Vehicle Detection Using Laser Scanners", 2017), made longer and wider away from the unit to KITTI's mean
  /// car where less is seen.
  std::vector<BevBox> bodies() const;

 private:
  std::span<const LidarPoint> points_;
  RoadSurface road_;
};

}  // namespace mirage
