// Which rig recorded a data set.
#pragma once

#include <filesystem>
#include <string>

namespace mirage {

/// The `rig` of DATA/dataset.json (generated sets have it), else "kitti64". InputError if it is no text.
std::string data_rig(const std::filesystem::path& data);

}  // namespace mirage
