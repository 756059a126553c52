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
  std::string text;  ///< the file itself
};
Rig read_rig(const std::filesystem::path& file);

/// One frame; depends only on (rig, seed, index). Labels follow KITTI (2-D box, truncation, occlusion from
/// what the camera sees of each vehicle). Vehicles with no visible pixel in the image are not labelled.
Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index);

}  // namespace mirage
