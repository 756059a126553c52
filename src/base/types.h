// Vectors and transforms. A transform is named target_from_source and a point p_frame (src/README.md).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <vector>

namespace mirage {

template <class S>
using Vec2 = Eigen::Matrix<S, 2, 1>;
template <class S>
using Vec3 = Eigen::Matrix<S, 3, 1>;
using Vec2d = Vec2<double>;
using Vec3d = Vec3<double>;
using Vec2f = Vec2<float>;
using Vec3f = Vec3<float>;
using Transform = Eigen::Isometry3d;

/// Triangle: three vertex indices, counter-clockwise seen from outside.
using Face = std::array<int, 3>;

}  // namespace mirage
