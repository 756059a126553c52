#include "scene/data/data_rig.h"

#include "base/error.h"
#include "base/files.h"
#include "scene/data/read_frames.h"

namespace mirage {

std::string data_rig(const std::filesystem::path& data) {
  const auto file = data / "dataset.json";
  if (!std::filesystem::exists(file)) return open_data_set(data)->rig();
  const nlohmann::json about = read_json(file, kLargestRecord);
  if (!about.is_object() || !about.contains("rig") || !about.at("rig").is_string())
    throw InputError(file.string(), "rig", "missing or not a text", "name the rig, for example \"kitti64\"");
  const std::string rig = about.at("rig");
  if (rig.empty() || rig.find('/') != std::string::npos || rig.find('\0') != std::string::npos)
    throw InputError(file.string(), "rig", "is no rig's name", "name the rig, for example \"kitti64\"");
  return rig;
}

std::string recorded_lidar_effects(const std::filesystem::path& data) {
  return std::filesystem::exists(data / "dataset.json") ? "noise,drop-out" : "unit";
}

}  // namespace mirage
