// A rig for quick generated frames.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <utility>

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

/// The same with a unit that turns all the way round and two further cameras, named by their direction.
/// Pictures of the first camera and of CAM_LEFT meet at `seam` (rad, from ahead to the left).
inline Rig surround_rig(double seam = 0.71) {
  Rig rig = small_rig();
  rig.camera = "CAM_FRONT";
  rig.lidar.azimuth_min = -std::numbers::pi;
  rig.lidar.azimuth_max = std::numbers::pi - rig.lidar.azimuth_step;
  const PinholeCamera& camera = rig.calibration.camera;
  const auto turned = [ahead = rig.calibration.camera_from_velo](double yaw) {
    return Transform(ahead * Eigen::AngleAxisd(-yaw, Vec3d::UnitZ()));
  };
  rig.others = {{"CAM_BACK", rig.calibration}, {"CAM_LEFT", rig.calibration}};
  rig.others[0].calibration.camera_from_velo = turned(std::numbers::pi);
  rig.others[1].calibration.camera_from_velo = turned(seam + std::atan2(camera.width - camera.cx, camera.fx));
  rig.calibration.camera_from_velo = turned(seam - std::atan2(camera.cx, camera.fx));
  return rig;
}

/// A street in CAM_BACK and CAM_FRONT_LEFT beside the rig's own camera: its labels come first, then those
/// that only these two see.
inline Frame surround_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index) {
  Frame frame = generate_frame(rig, seed, index);
  for (const auto& [name, yaw] : {std::pair("CAM_BACK", M_PI), std::pair("CAM_FRONT_LEFT", 1.1)}) {
    Rig turned = rig;
    turned.calibration.camera_from_velo =
        rig.calibration.camera_from_velo * Transform(Eigen::AngleAxisd(-yaw, Vec3d::UnitZ()));
    const Frame seen = generate_frame(turned, seed, index);
    frame.others.push_back({name, seen.calibration, Lazy<ImageF>([image = seen.image] { return image; })});
    Label unseen;  // of labels that only they see
    unseen.type = "Car";
    unseen.box = {{yaw > 2 ? -9.0 : 3.0, yaw > 2 ? 0.0 : 9.0, 4.2, 1.7, 0.1}, -1.73, 1.5};
    unseen.camera = static_cast<int>(frame.others.size());
    frame.labels.push_back(unseen);
  }
  return frame;
}

}  // namespace mirage::test
