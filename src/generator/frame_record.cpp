#include "generator/frame_record.h"

#include <fmt/format.h>

#include <vector>

#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

fs::path record_file(const fs::path& data, const std::string& id) {
  return data / "training/written" / (id + ".json");
}

/// Relative to training/. write_frame's files and those of the truth.
std::vector<std::string> files_of(const std::string& id, Truth truth) {
  std::vector<std::string> files;
  const auto add = [&](const char* pattern) { files.push_back(fmt::format(fmt::runtime(pattern), id)); };
  for (const char* pattern :
       {"image_2/{}.png", "velodyne/{}.bin", "calib/{}.txt", "label_2/{}.txt", "lighting/{}.json"})
    add(pattern);
  if (truth != Truth::none) add("depth/{}.png");
  if (truth == Truth::all) add("instance_2/{}.png"), add("instance_velodyne/{}.label");
  return files;
}

std::string track_of(const std::string& id) {
  return "track_2/" + id + ".txt";  // of frames with identities only
}

/// An empty object where there is none, or none that can be used.
nlohmann::json known(const fs::path& data, const std::string& id) {
  const fs::path file = record_file(data, id);
  if (!fs::is_regular_file(file)) return nlohmann::json::object();
  try {
    nlohmann::json record = read_json(file, kLargestRecord);
    for (const auto& [name, hash] : record.items())
      if (!hash.is_string()) return nlohmann::json::object();
    return record.is_object() ? record : nlohmann::json::object();
  } catch (const InputError&) {
    return nlohmann::json::object();
  }
}

std::string hash_of(const fs::path& file) {
  return fs::is_regular_file(file) ? file_hash(file, kLargestFile) : "";
}

}  // namespace

void record_frame(const fs::path& data, const std::string& id, Truth truth) {
  nlohmann::json record = known(data, id);
  std::vector<std::string> files = files_of(id, truth);
  if (fs::exists(data / "training" / track_of(id))) files.push_back(track_of(id));
  for (const std::string& name : files) record[name] = hash_of(data / "training" / name);
  write_json(record_file(data, id), record);
}

bool is_as_recorded(const fs::path& data, const std::string& id, Truth truth) {
  const nlohmann::json record = known(data, id);
  std::vector<std::string> files = files_of(id, truth);
  if (record.contains(track_of(id))) files.push_back(track_of(id));
  for (const std::string& name : files) {
    if (!record.contains(name)) return false;
    const fs::path file = data / "training" / name;
    const std::string now = hash_of(file);
    if (!now.empty() && now == record[name].get_ref<const std::string&>()) continue;
    spdlog::warn("{}: is not what was written ({}); the frame is made anew", file.string(),
                 fs::exists(file) ? "cut short or edited" : "removed");
    return false;
  }
  return true;
}

}  // namespace mirage
