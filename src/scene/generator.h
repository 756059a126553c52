// Generated driving frames: a first street generator, rendered by the ray-traced camera and the LiDAR model.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "scene/frame.h"

namespace mirage {

/// A rig file (scenes/rigs/NAME.toml): [camera], [lidar] and their mount.
struct Rig {
  std::string name;
  Calibration calibration;
  LidarModel lidar;
  std::string text;  ///< a rig file that holds this camera and this unit
};
Rig read_rig(const std::filesystem::path& file);
/// The same rig with another unit (see lidar_file) in place of its own, at the mount pose that the unit's file
/// gives; the velo origin keeps its height over the ground. The name becomes "RIG+UNIT".
Rig with_lidar(Rig rig, const std::string& unit);

/// One frame; depends only on (rig, seed, index), and not on whether `true_depth` is asked for: H×W, the
/// planar depth (m) of the ray nearest to each pixel's centre, 0 where it meets nothing (sky). Labels follow
/// KITTI (2-D box, truncation, occlusion from what the camera sees of each vehicle). Vehicles with no visible
/// pixel in the image are not labelled.
Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index, ImageF* true_depth = nullptr);

}  // namespace mirage
