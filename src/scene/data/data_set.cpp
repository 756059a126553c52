#include "scene/data/data_set.h"

#include <algorithm>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/names.h"
#include "scene/recorded_light.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

constexpr double kLongestStep = 1.5;  // s between neighbours

}  // namespace

void DataSet::check_id(const std::string& id) const {
  if (const std::string problem = frame_id_problem(id); !problem.empty())
    throw InputError(data_.string(), "frame \"" + id.substr(0, 2 * kLongestFrameId) + "\"", problem,
                     "give one of the names that `mirage view` and results show");
}

std::vector<DataSet::Part> DataSet::existing_parts(const std::string& id) const {
  check_id(id);
  std::vector<Part> all = parts(id);
  for (const Part& part : all)
    if (!fs::is_regular_file(part.file)) {
      if (!fs::exists(part.file.parent_path())) static_cast<void>(frames());  // no data set: it says why
      throw InputError(part.file.string(), "", std::string("missing (") + part.what + " of the frame)",
                       "add the file or drop the frame");
    }
  return all;
}

std::optional<Lighting> DataSet::lighting(const std::string&) const {
  return std::nullopt;
}

std::optional<Moment> DataSet::moment(const std::string&) const {
  return std::nullopt;
}

std::optional<std::string> DataSet::beside(const std::string&, int) const {
  return std::nullopt;
}

std::vector<SideCamera> DataSet::others(const std::string&) const {
  return {};
}

std::optional<std::vector<int>> DataSet::tracks(const std::string& id) const {
  const auto [width, height] = picture_size(id);
  std::vector<int> all;
  for (const Label& label : annotations(id, width, height).labels) all.push_back(label.track);
  return all;
}

std::pair<int, int> DataSet::picture_size(const std::string& id) const {
  int width = 0, height = 0;
  read_image_size(parts(id).at(1).file, width, height);
  return {width, height};
}

Frame DataSet::read(const std::string& id) const {
  const std::vector<Part> files = existing_parts(id);
  Frame frame;
  frame.id = id;
  frame.sweep = sweep(id);
  // Header, calibration, pixels: a header that claims too much contradicts the calibration before it costs
  // memory.
  const auto [width, height] = picture_size(id);
  Annotations known = annotations(id, width, height);
  frame.calibration = known.calibration;
  frame.image = read_srgb(files.at(1).file, {width, height});
  frame.labels = std::move(known.labels);
  frame.labelled = known.labelled;
  frame.camera = camera();
  frame.others = others(id);
  frame.moment = moment(id);
  if (frame.moment) add_velocities(id, frame);
  const auto own = lighting(id);
  frame.lighting = own ? *own : with_road_exposure(frame);
  return frame;
}

void DataSet::add_velocities(const std::string& id, Frame& frame) const {
  struct Seen {
    Moment at;
    std::vector<Label> labels;
  };
  std::vector<Seen> around = {{*frame.moment, frame.labels}};
  for (const int step : {-1, 1}) {
    const auto other = beside(id, step);
    const auto at = other ? moment(*other) : std::nullopt;
    // As nuScenes' devkit: what lies further apart says little of a velocity.
    if (!at || std::abs(at->time - frame.moment->time) > kLongestStep || at->time == frame.moment->time)
      continue;
    const PinholeCamera& camera = frame.calibration.camera;
    around.push_back({*at, annotations(*other, camera.width, camera.height).labels});
  }
  for (Label& label : frame.labels) {
    if (label.track < 0 || !has_box(label)) continue;
    std::vector<std::pair<double, Vec3d>> places;  // in the world, by time
    for (const Seen& seen : around) {
      const auto same = std::find_if(seen.labels.begin(), seen.labels.end(), [&](const Label& other) {
        return other.track == label.track && has_box(other);
      });
      if (same == seen.labels.end()) continue;
      const Box3& box = same->box;
      places.emplace_back(seen.at.time,
                          seen.at.world_from_ego * Vec3d(box.bev.x, box.bev.y, box.bottom + box.height / 2));
    }
    if (places.size() < 2) continue;
    const auto [first, last] = std::minmax_element(
        places.begin(), places.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    label.velocity = frame.moment->world_from_ego.linear().transpose() * (last->second - first->second) /
                     (last->first - first->first);
  }
}

std::string DataSet::annotations_hash(const std::string& id) const {
  std::string hashes;
  const std::vector<Part> all = parts(id);
  for (std::size_t i = 2; i < all.size(); ++i) hashes += file_hash(all[i].file, kLargestFile);
  return hashes;
}

std::string DataSet::hash(const std::string& id) const {
  const std::vector<Part> files = existing_parts(id);
  return content_hash(file_hash(files.at(0).file, kLargestFile) + file_hash(files.at(1).file, kLargestFile) +
                      annotations_hash(id));
}

}  // namespace mirage
