// Angles, in radians unless a name says otherwise.
#pragma once

#include <cmath>
#include <numbers>

#include "base/types.h"

namespace mirage {

inline constexpr double kDegree = std::numbers::pi / 180;  ///< radians in a degree

/// The same direction in [−π, π).
inline double wrap_angle(double angle) {
  constexpr double pi = std::numbers::pi;
  return angle - 2 * pi * std::floor((angle + pi) / (2 * pi));
}

/// Unit vector at `azimuth`, counter-clockwise from x, and `elevation` above the xy plane.
inline Vec3d unit_vector(double azimuth, double elevation) {
  return {std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
          std::sin(elevation)};
}

}  // namespace mirage
