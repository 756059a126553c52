// Pinhole camera. Frame `camera`: x right, y down, z forward. Pixel (u, v): the centre of the top-left pixel
// is (0, 0), as KITTI's P2 has it (Hartley & Zisserman, Multiple View Geometry, section 6.1).
#pragma once

#include "base/types.h"

namespace mirage {

/// A camera without distortion: u = fx x / z + cx, v = fy y / z + cy, in `camera`; pixel centres are whole
/// numbers.
struct PinholeCamera {
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  int width = 0, height = 0;              ///< pixels

  /// Pixel coordinates of a point in front of the camera (p_camera.z > 0).
  template <class S>
  Vec2<S> project(const Vec3<S>& p_camera) const {
    return {S(fx) * p_camera.x() / p_camera.z() + S(cx), S(fy) * p_camera.y() / p_camera.z() + S(cy)};
  }
  /// The point at depth z (planar, metres) behind pixel (u, v).
  Vec3d unproject(double u, double v, double z) const { return {(u - cx) / fx * z, (v - cy) / fy * z, z}; }
};

}  // namespace mirage
