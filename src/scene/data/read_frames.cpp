#include "scene/data/read_frames.h"

#include "scene/data/layouts.h"

namespace mirage {

namespace fs = std::filesystem;

std::shared_ptr<const DataSet> open_data_set(const fs::path& data) {
  for (const auto open : {open_given_labels, open_nuscenes, open_kitti_raw, open_kitti_tracking})
    if (auto data_set = open(data)) return data_set;
  return open_kitti_object(data);
}

std::vector<std::string> list_frames(const fs::path& data) {
  return open_data_set(data)->frames();
}

Frame read_frame(const fs::path& data, const std::string& id) {
  return open_data_set(data)->read(id);
}

std::string frame_hash(const fs::path& data, const std::string& id) {
  return open_data_set(data)->hash(id);
}

std::optional<std::vector<int>> read_tracks(const fs::path& data, const std::string& id) {
  return open_data_set(data)->tracks(id);
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
