// Which rig recorded a data set.
#pragma once

#include <filesystem>
#include <string>

#include "sensors/lidar_model.h"

namespace mirage {

/// A rig file (its name ends in .toml), or a shipped one by its name. FieldError that lists those there are.
std::filesystem::path rig_file(const std::string& rig);

/// What every command that reads data says of its option --rig.
inline constexpr const char* kRigHelp =
    "rig that recorded the data: a shipped rig's name or a rig file (*.toml; mirage rig makes one). If "
    "empty: the rig that the data set names, else the standard rig of its layout";

/// The name of the rig that recorded the set, which chooses shipped weights: `rig`, if that is a shipped
/// one's name; else the `rig` of DATA/dataset.json (generated sets have it), else the layout's
/// (DataSet::rig). InputError if that is no text, and as rig_file's.
std::string data_rig(const std::filesystem::path& data, const std::string& rig = "");

/// The LiDAR that recorded the set: that of `rig` (as rig_file takes it) where it is given, else of the set's
/// own rig.toml, else of the rig that data_rig names. InputError as read_lidar_model's.
LidarModel lidar_of(const std::filesystem::path& data, const std::string& rig = "");

/// Whether nobody says which rig recorded the set: no `rig` is given, DATA holds neither rig.toml nor
/// dataset.json, and its layout is one of KITTI's, which other recordings are converted to.
bool rig_is_assumed(const std::filesystem::path& data, const std::string& rig = "");

/// What returns of the set's own sweeps have, in words of parse_lidar_effects (sensors/lidar_effects.h).
/// Generated (dataset.json): noise and drop-out, of thin rays (sensors/lidar_sweep.h). Recorded: what
/// lidar_of(data, rig) says of its sweeps (LidarModel::recorded_effects). InputError as lidar_of's.
std::string recorded_lidar_effects(const std::filesystem::path& data, const std::string& rig = "");
/// The word that asks for them.
inline constexpr const char* kAsRecorded = "as-recorded";

}  // namespace mirage
