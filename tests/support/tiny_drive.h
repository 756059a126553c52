// The tiny world's car as a vehicle that a data set follows.
#pragma once

#include <fmt/format.h>

#include <filesystem>
#include <string>
#include <vector>

#include "attack/tiny_world.h"
#include "base/files.h"
#include "scene/data/read_frames.h"
#include "support/layouts.h"

namespace mirage::test {

/// The car of write_tiny_data as vehicle 4 of sequence 0000 in KITTI's tracking layout, while the ego vehicle
/// stands still. `scratch`: folder for the single frames.
inline void write_tiny_drive(const std::filesystem::path& data, const std::filesystem::path& scratch,
                             int count) {
  write_tiny_data(scratch, count);
  std::vector<Frame> frames;
  std::string poses;
  for (int i = 0; i < count; ++i) {
    Frame frame = read_frame(scratch, fmt::format("{:06}", i));
    frame.labels.at(0).track = 4;
    frames.push_back(frame);
    poses += fmt::format("49.01 8.43 112.5 0 0 {}", 0.001 * i);
    for (int n = 6; n < 30; ++n) poses += " 0";
    poses += "\n";
  }
  write_tracking(data, frames);
  const auto calibration = data / "training/calib/0000.txt";
  write_file(calibration, read_file(calibration) + "Tr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0\n");
  write_file(data / "training/oxts/0000.txt", poses);
}

}  // namespace mirage::test
