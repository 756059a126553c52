// A car's rectangle in the picture, by its box from above and the lowest returns around it. Header only: a
// detector plugin, which links no layer but base, needs it too.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <span>
#include <vector>

#include "base/sizes.h"
#include "detection/matching.h"
#include "geometry/box.h"
#include "scene/frame.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// Height of KITTI's mean car (m).
inline constexpr double kNominalHeight = 1.53;

/// The returns' values: x, y, z and reflectance of each.
inline std::span<const float> floats_of(std::span<const LidarPoint> points) {
  static_assert(sizeof(LidarPoint) == 4 * sizeof(float));
  return {reinterpret_cast<const float*>(points.data()), 4 * points.size()};
}

/// The lowest return of each square metre ahead.
class LowestReturns {
 public:
  static constexpr int kRows = 70, kColumns = 80;  ///< m (`velo`): x from 0, y from −40
  static constexpr float kNone = 1e9f;             ///< m
  /// `points`: x, y, z and a fourth value each (m, `velo`). `deepest`: lower ones are left out.
  explicit LowestReturns(std::span<const float> points, double deepest = -2.6)
      : lowest_(as_size(kRows) * kColumns, kNone) {
    for (std::size_t i = 0; i + 3 < points.size(); i += 4) {
      const double x = points[i], y = points[i + 1] + kColumns / 2.0;
      if (!(x >= 0 && x < kRows && y >= 0 && y < kColumns && points[i + 2] > deepest)) continue;
      float& lowest = lowest_[static_cast<std::size_t>(x) * kColumns + static_cast<std::size_t>(y)];
      lowest = std::min(lowest, points[i + 2]);
    }
  }
  /// z (m) of a square metre; kNone without a return.
  float at(int row, int column) const { return lowest_[as_size(row) * kColumns + as_size(column)]; }
  /// Height (m) of the ground around a box: the lowest return up to kNearby m around it, or kGround if there
  /// is none below kHighest.
  double ground(const BevBox& box) const {
    const double reach = std::hypot(box.length, box.width) / 2 + kNearby;
    const auto bound = [](double at, int size) {
      return static_cast<int>(std::clamp(std::floor(at), 0.0, size - 1.0));
    };
    float lowest = kNone;
    const double x = box.x, y = box.y + kColumns / 2.0;
    for (int row = bound(x - reach, kRows); row <= bound(x + reach, kRows); ++row)
      for (int column = bound(y - reach, kColumns); column <= bound(y + reach, kColumns); ++column)
        lowest = std::min(lowest, at(row, column));
    return lowest < kHighest ? lowest : kGround;
  }

 private:
  static constexpr double kGround = -1.7, kNearby = 1, kHighest = 1;  // m
  std::vector<float> lowest_;
};

/// The rectangle around the corners of a car's box of kNominalHeight m on that ground, within a picture of
/// width × height pixels; nullopt if no part of it lies in the picture. `pixel_from_velo`: row-major 3 × 4.
/// Corners behind the camera count as 0.1 m before it.
inline std::optional<PictureBox> car_in_picture(const BevBox& box, double ground,
                                                const std::array<double, 12>& pixel_from_velo, int width,
                                                int height) {
  PictureBox seen{1e9, 1e9, -1e9, -1e9};
  const double c = std::cos(box.yaw), s = std::sin(box.yaw);
  for (int k = 0; k < 8; ++k) {
    const double along = (k & 1 ? 0.5 : -0.5) * box.length, across = (k & 2 ? 0.5 : -0.5) * box.width;
    const std::array<double, 3> p = {box.x + c * along - s * across, box.y + s * along + c * across,
                                     ground + (k & 4 ? kNominalHeight : 0)};
    const auto row = [&](std::size_t r) {
      return pixel_from_velo[4 * r] * p[0] + pixel_from_velo[4 * r + 1] * p[1] +
             pixel_from_velo[4 * r + 2] * p[2] + pixel_from_velo[4 * r + 3];
    };
    const double depth = std::max(row(2), 0.1);
    seen.left = std::min(seen.left, row(0) / depth), seen.right = std::max(seen.right, row(0) / depth);
    seen.top = std::min(seen.top, row(1) / depth), seen.bottom = std::max(seen.bottom, row(1) / depth);
  }
  seen.left = std::max(seen.left, 0.0), seen.right = std::min(seen.right, width - 1.0);
  seen.top = std::max(seen.top, 0.0), seen.bottom = std::min(seen.bottom, height - 1.0);
  if (!(seen.right > seen.left && seen.bottom > seen.top)) return {};
  return seen;
}

// The height of a box that is known from above alone.

/// The box in space as found; if it has no height, with bottom and height from the sweep. Bottom: the 5 %
/// quantile of the returns in and up to 0.5 m around it (up to 6 m where there are fewer than 15; of the
/// whole sweep, where there are none). Height: from there to the 98 % quantile of the returns within it, if
/// these are 20 or more and it is 1.2 to 2.2 m; otherwise kNominalHeight. On the 160 labelled cars of 44
/// KITTI frames the bottom is off by 8 cm in the mean, the height by 6 cm.
Box3 upright(const ObjectBoxes& found, std::span<const LidarPoint> sweep);

// The part of a sweep that detectors get.

/// The points in front of the camera that project into its image, in the sweep's order. KITTI labels only
/// objects in the camera's view, so training, detection and attack search only this part of the sweep.
std::vector<LidarPoint> points_in_view(const Sweep& sweep, const Calibration& calibration);

/// Row-major 3 × 4 projection: (u w, v w, w) = M (x, y, z, 1) for a point in `velo`.
std::array<double, 12> pixel_from_velo(const Calibration& calibration);

}  // namespace mirage
