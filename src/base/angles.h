// Angles, in radians unless a name says otherwise.
#pragma once

#include <cmath>
#include <numbers>

namespace mirage {

inline constexpr double kDegree = std::numbers::pi / 180;  ///< radians in a degree

/// The same direction in [−π, π).
inline double wrap_angle(double angle) {
  constexpr double pi = std::numbers::pi;
  return angle - 2 * pi * std::floor((angle + pi) / (2 * pi));
}

}  // namespace mirage
