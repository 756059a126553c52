#include "scene/data/data_rig.h"

#include <algorithm>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "scene/data/read_frames.h"

namespace mirage {

namespace fs = std::filesystem;

fs::path rig_file(const std::string& rig) {
  if (rig.ends_with(".toml")) {
    if (!fs::is_regular_file(rig))
      throw FieldError("rig", rig, "no such file", "`mirage rig --data LOG --out FILE.toml` makes one");
    return rig;
  }
  return shipped_choice("scenes/rigs", ".toml", rig, "rig", "a rig file (.toml)");
}

std::string data_rig(const fs::path& data, const std::string& rig) {
  if (!rig.empty() && !rig.ends_with(".toml")) return rig_file(rig).stem().string();
  const auto file = data / "dataset.json";
  if (!fs::exists(file)) return open_data_set(data)->rig();
  const nlohmann::json about = read_json(file, kMaxRecordBytes);
  if (!about.is_object() || !about.contains("rig") || !about.at("rig").is_string())
    throw InputError(file.string(), "rig", "missing or not a text", "name the rig, for example \"kitti64\"");
  const std::string named = about.at("rig");
  if (named.empty() || named.find('/') != std::string::npos || named.find('\0') != std::string::npos)
    throw InputError(file.string(), "rig", "is not a rig's name", "name the rig, for example \"kitti64\"");
  return named;
}

LidarModel lidar_of(const fs::path& data, const std::string& rig) {
  if (!rig.empty()) return read_lidar_model(rig_file(rig));
  if (const auto own = data / "rig.toml"; fs::exists(own)) return read_lidar_model(own);
  const std::string named = data_rig(data);
  const std::vector<std::string> shipped = shipped_names("scenes/rigs", ".toml");
  if (std::ranges::find(shipped, named) == shipped.end())
    throw InputError((data / "dataset.json").string(), "rig", "\"" + named + "\" is not a shipped rig",
                     use_one_of(named, shipped, "a rig.toml beside it"));
  return read_lidar_model(shipped_file("scenes/rigs/" + named + ".toml"));
}

bool rig_is_assumed(const fs::path& data, const std::string& rig) {
  return rig.empty() && !fs::exists(data / "rig.toml") && !fs::exists(data / "dataset.json") &&
         std::string(open_data_set(data)->layout()).starts_with("kitti");
}

std::string recorded_lidar_effects(const fs::path& data, const std::string& rig) {
  if (fs::exists(data / "dataset.json")) return "noise,drop-out";
  return lidar_of(data, rig).recorded_effects;
}

}  // namespace mirage
