// A rig for quick generated frames.
#pragma once

#include <numbers>

#include "generator/generator.h"

namespace mirage::test {

/// A small camera and a coarse LiDAR with KITTI's field of view, for speed.
inline Rig small_rig() {
  Rig rig;
  rig.name = "small";
  rig.calibration.camera = {180, 180, 155, 43, 310, 94};
  Eigen::Matrix3d r;
  r << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  rig.calibration.camera_from_velo.linear() = r;
  rig.calibration.camera_from_velo.translation() = Vec3d(0.0, -0.08, -0.27);
  constexpr double degree = std::numbers::pi / 180;
  for (int i = 0; i < 64; ++i) rig.lidar.beams.push_back({(2 - 0.4 * i) * degree, 0, 0, 0});
  rig.lidar.azimuth_step = 0.5 * degree;
  rig.lidar.azimuth_min = -45 * degree;
  rig.lidar.azimuth_max = 45 * degree;
  rig.lidar.range_min = 1;
  rig.lidar.range_max = 120;
  rig.lidar.rate = 10;
  rig.lidar.height = 1.73;
  return rig;
}

}  // namespace mirage::test
