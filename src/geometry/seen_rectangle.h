// Rectangles around what a LiDAR unit at the origin sees of a thing from above: two sides of it at most.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "geometry/box.h"

namespace mirage {

/// An interval along one axis of a rectangle.
struct SeenSide {
  double low = 0, high = 0;
  /// Its length.
  double size() const { return high - low; }
  /// Made `least` long, away from the unit, which stands at 0: what is near is what is seen.
  SeenSide grown(double least) const { return size() >= least ? *this : sized(least); }
  /// Made `length` long; the end that is nearer to the unit stays.
  SeenSide sized(double length) const {
    return std::abs(low) <= std::abs(high) ? SeenSide{low, low + length} : SeenSide{high - length, high};
  }
};

/// A rectangle in axes that are turned by `yaw` around the unit.
struct SeenRectangle {
  double yaw = 0;  ///< rad, in [0, π/2)
  SeenSide along, across;
  /// The same with its centre; its length is along `yaw`.
  BevBox box() const;
};

/// The rectangle around places (m) to whose nearer sides they are closest, of headings 2° apart: the
/// closeness criterion of Zhang, Xu, Dolan, Litkouhi: "Efficient L-Shape Fitting for Vehicle Detection Using
/// Laser Scanners", IV 2017. For at least one place.
SeenRectangle closest_rectangle(const std::vector<Vec2d>& places);

/// The box of a car of which that rectangle is seen, made longer and wider away from the unit to KITTI's mean
/// car where less is seen; nothing if it is no car's.
std::optional<BevBox> car_seen_as(const SeenRectangle& seen);

}  // namespace mirage
