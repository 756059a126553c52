// Generated drives on disk, in the layout of KITTI's tracking benchmark (scene/data/kitti_drives.cpp), with
// the car's own poses and speeds (oxts) and the frames' times. training/motion_02/SEQUENCE.txt has what moves
// and what stands as it truly is, a row for each labelled thing of a frame: frame, identity, role ("stands"
// or Mover::role), then in the world x, y, z of the ground under its box, yaw, and the velocity's x, y, z (m,
// rad, m/s).
#pragma once

#include <filesystem>
#include <functional>

#include "generator/dataset.h"

namespace mirage {

/// Writes drives [first, first + count) of (rig, seed), each of `seconds`, a frame each kDriveStep. Frames
/// that are as they were written are kept. A folder made of another rig, seed, generator or length is refused
/// (InputError). After Ctrl-C the frames in hand are finished and Interrupted is thrown. `tell` gets frames.
DatasetSummary generate_drives(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                               double seconds, const std::filesystem::path& out,
                               const std::function<void(std::size_t done)>& tell);

/// Frames of a drive.
int frames_of_drive(double seconds);

}  // namespace mirage
