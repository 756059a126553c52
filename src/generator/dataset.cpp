#include "generator/dataset.h"

#include <fmt/format.h>

#include <mutex>
#include <vector>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"

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

/// Of frames with several cameras only: what training/cameras has of the frame.
std::vector<std::string> camera_files(const fs::path& data, const std::string& id) {
  const fs::path training = data / "training";
  const std::string about = "cameras/" + id + ".json";
  if (!fs::exists(training / about)) return {};
  std::vector<std::string> files = {about};
  for (const auto& entry : fs::directory_iterator(training / "cameras"))
    if (const fs::path picture = entry.path() / (id + ".png"); fs::exists(picture))
      files.push_back(fs::relative(picture, training).generic_string());
  return files;
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
  for (std::string& name : camera_files(data, id)) files.push_back(std::move(name));
  for (const std::string& name : files) record[name] = hash_of(data / "training" / name);
  write_json(record_file(data, id), record);
}

bool is_as_recorded(const fs::path& data, const std::string& id, Truth truth) {
  const nlohmann::json record = known(data, id);
  std::vector<std::string> files = files_of(id, truth);
  for (const auto& [name, hash] : record.items())
    if (name == track_of(id) || name.starts_with("cameras/")) files.push_back(name);
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

namespace {

constexpr const char* kDrives = "drives_of_s";  // a field of sets that are drives

}  // namespace

void begin_dataset(const Rig& rig, const nlohmann::json& about, const std::filesystem::path& out) {
  make_output_folder(out);
  const std::filesystem::path file = out / "dataset.json", kept = out / "rig.toml";
  if (std::filesystem::exists(file)) {
    const nlohmann::json before = read_json(file, kLargestRecord);
    if (!before.is_object())
      throw InputError(file.string(), "", "is no object of a data set's fields",
                       "choose another --out folder");
    if (before.contains(kDrives) != about.contains(kDrives))
      throw InputError(file.string(), kDrives,
                       before.contains(kDrives) ? "is there: the folder holds drives"
                                                : "is missing: the folder holds single frames",
                       "choose another --out folder");
    for (const auto& [key, value] : about.items())
      if (before.value(key, nlohmann::json()) != value)
        throw InputError(
            file.string(), key,
            fmt::format("is {}, asked for is {}", before.value(key, nlohmann::json()).dump(), value.dump()),
            "choose another --out folder");
    if (!std::filesystem::exists(kept))
      throw InputError(kept.string(), "", "is missing, and with it which rig drew the frames there",
                       "restore the file or choose another --out folder");
  }
  // Other commands need the very LiDAR, not its name; and frames of an edited rig are not this set's.
  if (std::filesystem::exists(kept) && read_toml(kept) != parse_toml(rig.text, rig.name))
    throw InputError(kept.string(), "", "is not the rig " + rig.name + " as it is now",
                     "choose another --out folder, or restore the rig file");
  // The rig first: a set that was stopped between the two goes on, and one without its rig has lost it.
  write_file(kept, rig.text);
  write_json(file, about);
}

DatasetSummary generate_dataset(const Rig& rig, std::uint64_t seed, std::uint64_t first, int count,
                                const std::filesystem::path& out,
                                const std::function<void(std::size_t)>& tell, Truth truth) {
  begin_dataset(
      rig, {{"rig", rig.name}, {"seed", seed}, {"look", name_of(rig.look)}, {"generator", kGeneratorVersion}},
      out);
  DatasetSummary sum;
  std::mutex mutex;
  std::size_t done = 0;
  const std::vector<std::size_t> order = order_among_ranks(static_cast<std::size_t>(count));
  parallel_for(order.size(), [&](std::size_t k) {
    if (interrupted()) return;
    const std::uint64_t index = first + order[k];
    const std::string id = fmt::format("{:06}", index);
    const bool keep = is_as_recorded(out, id, truth);
    std::vector<Label> labels;
    if (keep) {
      labels = read_annotations(out, id).labels;
    } else {
      FrameTruth known;
      Frame frame = generate_frame(rig, seed, index, truth == Truth::none ? nullptr : &known);
      // Before the frame: its sweep comes last, so that a listed frame has its truth.
      if (truth != Truth::none) write_depth_png(true_depth_file(out, frame.id), known.depth);
      if (truth == Truth::all) {
        write_index_png(instance_file(out, frame.id), known.instance);
        write_point_labels(point_label_file(out, frame.id), known.returns);
      }
      write_frame(out, frame);
      record_frame(out, frame.id, truth);
      labels = std::move(frame.labels);
    }
    const std::scoped_lock lock(mutex);
    ++(keep ? sum.kept : sum.written);
    for (const Label& label : labels) ++(label.type == "Car" ? sum.cars : sum.others);
    sum.points += fs::file_size(out / "training" / "velodyne" / (id + ".bin")) / sizeof(LidarPoint);
    tell(++done);
  });
  throw_if_interrupted("the frames written so far are kept; the same command goes on from there");
  return sum;
}

}  // namespace mirage
