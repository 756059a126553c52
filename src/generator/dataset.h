// The record of a generated frame's files: training/written/ID.json, {"image_2/ID.png": content hash, …}. A
// frame counts as complete by its content: after a full disk or a power cut, existing files prove nothing.
#pragma once

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "generator/generator.h"
#include "scene/data/kitti.h"

namespace mirage {

/// True if the record lists all files of the frame and of `truth`, and each file is as recorded. Warns of a
/// file that differs (cut short, edited).
bool is_as_recorded(const std::filesystem::path& data, const std::string& id, Truth truth);

// A whole generated data set on disk.

/// Changes whenever the same seed gives other frames.
inline constexpr int kGeneratorVersion = 5;

/// Counts over the frames written in this run.
struct DatasetSummary {
  int written = 0, existing = 0, cars = 0, others = 0;
  std::size_t points = 0;
};

/// Writes frames [first, first + count) of (rig, seed) to `out` and dataset.json. Frames whose files are as
/// recorded (dataset.h) are kept (more truth can be added to a set later: the other files come out the same);
/// a folder made with another rig, seed or generator version is refused (InputError). Several frames are made
/// at once. After Ctrl-C the frames in hand are finished and Interrupted is thrown.
DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t done)>& progress,
                                Truth truth = Truth::none);

// Generated drives on disk, in the layout of KITTI's tracking benchmark (scene/data/kitti_drives.cpp), with
// the car's own poses and speeds (oxts) and the frames' times. training/motion_02/SEQUENCE.txt has the true
// motion, one row for each labelled thing of a frame: frame, identity, role ("stands" or Mover::role), then
// in the world x, y, z of the ground under its box, yaw, and the velocity's x, y, z (m, rad, m/s).

/// Writes drives [first, first + count) of (rig, seed), each of `seconds`, a frame each kDriveStep. Unchanged
/// frames are kept. A folder made with another rig, seed, generator or length is refused (InputError). After
/// Ctrl-C the frames in hand are finished and Interrupted is thrown. `progress` gets the number of finished
/// frames.
DatasetSummary generate_drives(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                               double seconds, const std::filesystem::path& out,
                               const std::function<void(std::size_t done)>& progress);

/// Frames of a drive.
int frames_of_drive(double seconds);

}  // namespace mirage
