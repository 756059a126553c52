// Which rig recorded a data set.
#pragma once

#include <filesystem>
#include <string>

namespace mirage {

/// The `rig` of DATA/dataset.json (generated sets have it), else the layout's (DataSet::rig). InputError if
/// it is no text.
std::string data_rig(const std::filesystem::path& data);

/// What returns of the set's own sweeps have, in words of parse_lidar_effects (sensors/lidar_effects.h).
/// Generated (dataset.json): noise and drop-out, of thin rays (sensors/lidar_sweep.h). Recorded: the unit's.
std::string recorded_lidar_effects(const std::filesystem::path& data);
/// The word that asks for them.
inline constexpr const char* kAsRecorded = "as-recorded";

}  // namespace mirage
