// Vectors and transforms. A transform is named target_from_source and a point p_frame (src/README.md).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>

namespace mirage {

/// Two coordinates, in m or pixels.
template <class S>
using Vec2 = Eigen::Matrix<S, 2, 1>;
/// Three coordinates (m) or channels.
template <class S>
using Vec3 = Eigen::Matrix<S, 3, 1>;
/// Two coordinates in double.
using Vec2d = Vec2<double>;
/// Three in double.
using Vec3d = Vec3<double>;
/// Two coordinates in float.
using Vec2f = Vec2<float>;
/// Three in float.
using Vec3f = Vec3<float>;
/// Rotation and translation (m), in double.
using Transform = Eigen::Isometry3d;

/// Triangle: three vertex indices, counter-clockwise seen from outside.
using Face = std::array<int, 3>;

/// The z of the cross product of two directions in a plane.
inline double cross(const Vec2d& a, const Vec2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

// Angles, in radians unless a name says otherwise.

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
