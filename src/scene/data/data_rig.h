// The rig that recorded a data set.
#pragma once

#include <filesystem>
#include <string>

#include "sensors/lidar_model.h"

namespace mirage {

/// The path of a rig file (*.toml) or of a shipped rig by name. FieldError, listing the shipped rigs.
std::filesystem::path rig_file(const std::string& rig);

/// The help of the option --rig in every command that reads data.
inline constexpr const char* kRigHelp =
    "rig that recorded the data: a shipped rig's name or a rig file (*.toml; mirage rig makes one). If "
    "empty: the rig that the data set names, else the standard rig of its layout";

/// The name of the rig that recorded the set; it selects shipped weights. `rig` if it is a shipped rig's
/// name, otherwise the `rig` of DATA/dataset.json (generated sets have it), otherwise the layout's
/// (DataSet::rig). InputError if that is not text, and as rig_file's.
std::string data_rig(const std::filesystem::path& data, const std::string& rig = "");

/// The LiDAR that recorded the set: that of `rig` (as rig_file takes it) unless empty, otherwise of the set's
/// rig.toml, otherwise of the rig that data_rig names. InputError as read_lidar_model's.
LidarModel lidar_of(const std::filesystem::path& data, const std::string& rig = "");

/// Whether the rig is only assumed: `rig` is empty, DATA holds neither rig.toml nor dataset.json, and its
/// layout is one of KITTI's, which other recordings are often converted to.
bool rig_is_assumed(const std::filesystem::path& data, const std::string& rig = "");

/// LiDAR effects in the set's own sweeps, in words of parse_lidar_effects (sensors/lidar_effects.h).
/// Generated (dataset.json): noise and drop-out, of thin rays (sensors/lidar_sweep.h). Recorded:
/// LidarModel::recorded_effects of lidar_of(data, rig). InputError as lidar_of's.
std::string recorded_lidar_effects(const std::filesystem::path& data, const std::string& rig = "");
/// The word that requests them.
inline constexpr const char* kAsRecorded = "as-recorded";

}  // namespace mirage
