#include "scene/data/read_frames.h"

#include <fmt/format.h>

#include <algorithm>

#include "base/error.h"
#include "base/words.h"
#include "scene/data/layouts.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

/// InputError that names the nearest frames if the set has none of that name.
void require_frame(const fs::path& data, const DataSet& set, const std::string& id) {
  constexpr std::size_t kNamed = 10;
  std::vector<std::string> frames;
  try {
    frames = set.frames();
  } catch (const InputError&) {  // has none at all
  }
  if (frames.empty() || std::find(frames.begin(), frames.end(), id) != frames.end()) return;
  std::stable_sort(frames.begin(), frames.end(), [&](const std::string& a, const std::string& b) {
    return slips_between(id, a) < slips_between(id, b);
  });
  const std::size_t count = frames.size();
  if (count > kNamed) frames.resize(kNamed);
  throw InputError(
      data.string(), "frame " + id, "no such frame",
      use_one_of(id, frames, count > kNamed ? fmt::format("another of its {} frames", count) : ""));
}

}  // namespace

std::shared_ptr<const DataSet> open_data_set(const fs::path& data, Cameras cameras) {
  std::shared_ptr<const DataSet> set;
  for (const auto open : {open_given_labels, open_nuscenes, open_kitti_raw, open_kitti_tracking})
    if (!set) set = open(data);
  if (!set) set = open_kitti_object(data);
  if (cameras == Cameras::all)
    if (auto whole = set->with_all_cameras()) return whole;
  return set;
}

std::vector<std::string> list_frames(const fs::path& data) {
  return open_data_set(data)->frames();
}

Frame read_frame(const fs::path& data, const std::string& id, Cameras cameras) {
  const auto set = open_data_set(data, cameras);
  try {
    return set->read(id);
  } catch (const InputError&) {
    require_frame(data, *set, id);  // what is wrong of a file of it says nothing to who misspelt the frame
    throw;
  }
}

std::string frame_hash(const fs::path& data, const std::string& id, Cameras cameras) {
  return open_data_set(data, cameras)->hash(id);
}

std::optional<std::vector<int>> read_tracks(const fs::path& data, const std::string& id) {
  return open_data_set(data, Cameras::all)->tracks(id);
}

fs::path picture_file(const fs::path& data, const std::string& id) {
  return open_data_set(data)->parts(id).at(1).file;
}

Annotations read_annotations(const fs::path& data, const std::string& id) {
  const auto set = open_data_set(data);
  const auto [width, height] = set->picture_size(id);
  return set->annotations(id, width, height);
}

}  // namespace mirage
