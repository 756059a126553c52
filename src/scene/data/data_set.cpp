#include "scene/data/data_set.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/image.h"
#include "base/names.h"
#include "scene/recorded_light.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

constexpr double kMaxStep = 1.5;  // s between neighbours

using Named = std::pair<std::string_view, const char*>;

/// Types by names in lower case. Classes whose boxes cannot be evaluated are DontCare.
constexpr auto kTypes = std::to_array<Named>({
    // KITTI
    {"car", "Car"},
    {"van", "Van"},
    {"truck", "Truck"},
    {"pedestrian", "Pedestrian"},
    {"person_sitting", "Person_sitting"},
    {"person (sitting)", "Person_sitting"},  // of the raw recordings' tracklets
    {"person", "Pedestrian"},                // of the tracking benchmark
    {"cyclist", "Cyclist"},
    {"tram", "Tram"},
    {"misc", "Misc"},
    {"dontcare", "DontCare"},
    // nuScenes' categories; a longer category matches its prefix in this table
    {"vehicle.car", "Car"},
    {"vehicle.emergency", "Van"},
    {"vehicle.truck", "Truck"},
    {"vehicle.trailer", "Truck"},
    {"vehicle.construction", "Truck"},
    {"vehicle.bus", "Bus"},
    {"vehicle.bicycle", "Cyclist"},
    {"vehicle.motorcycle", "Cyclist"},
    {"human.pedestrian", "Pedestrian"},
    {"animal", "Animal"},
    {"movable_object.barrier", "Misc"},
    {"movable_object.debris", "Misc"},
    {"movable_object.pushable_pullable", "Misc"},
    {"movable_object.trafficcone", "Misc"},
    {"static_object.bicycle_rack", "Misc"},
    // nuScenes' detection names, Lyft's
    {"trailer", "Truck"},
    {"construction_vehicle", "Truck"},
    {"bus", "Bus"},
    {"bicycle", "Cyclist"},
    {"motorcycle", "Cyclist"},
    {"traffic_cone", "Misc"},
    {"barrier", "Misc"},
    {"emergency_vehicle", "Van"},
    {"other_vehicle", "Truck"},
    // Waymo
    {"vehicle", "Car"},
    {"type_vehicle", "Car"},
    {"type_pedestrian", "Pedestrian"},
    {"type_cyclist", "Cyclist"},
    {"type_sign", "Misc"},
    {"sign", "Misc"},
    {"type_unknown", "DontCare"},
    {"unknown", "DontCare"},
    // Argoverse 1 and 2
    {"regular_vehicle", "Car"},
    {"large_vehicle", "Truck"},
    {"box_truck", "Truck"},
    {"truck_cab", "Truck"},
    {"vehicular_trailer", "Truck"},
    {"articulated_bus", "Bus"},
    {"school_bus", "Bus"},
    {"railed_vehicle", "Tram"},
    {"bicyclist", "Cyclist"},
    {"motorcyclist", "Cyclist"},
    {"moped", "Cyclist"},
    {"wheeled_device", "Misc"},
    {"wheeled_rider", "Cyclist"},
    {"wheelchair", "Pedestrian"},
    {"stroller", "Pedestrian"},
    {"official_signaler", "Pedestrian"},
    {"dog", "Animal"},
    {"bollard", "Misc"},
    {"construction_barrel", "Misc"},
    {"construction_cone", "Misc"},
    {"stop_sign", "Misc"},
    {"mobile_pedestrian_crossing_sign", "Misc"},
    {"mobile_pedestrian_sign", "Misc"},
    {"message_board_trailer", "Misc"},
    {"traffic_light_trailer", "Misc"},
    {"traffic_light", "Misc"},
    {"on_road_obstacle", "Misc"},
    {"other_mover", "Misc"},
});

/// The table's type for a name; null if it has none.
const char* known_type(std::string_view name) {
  std::string lower(name);
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  const bool category = lower.find('.') != std::string::npos;
  while (true) {
    const auto found = std::ranges::find(kTypes, lower, &Named::first);
    if (found != kTypes.end()) return found->second;
    const auto dot = lower.rfind('.');
    if (dot == std::string::npos) return nullptr;
    lower.resize(dot);
    // "vehicle.foo" is not a "vehicle": Waymo's word is a whole name.
    if (category && lower.find('.') == std::string::npos) return nullptr;
  }
}

}  // namespace

void DataSet::check_id(const std::string& id) const {
  if (const std::string problem = frame_id_problem(id); !problem.empty())
    throw InputError(data_.string(), "frame \"" + id.substr(0, 2 * kMaxFrameIdLength) + "\"", problem,
                     "give one of the names that `mirage view` and results show");
}

std::vector<DataSet::SourceFile> DataSet::existing_files(const std::string& id) const {
  check_id(id);
  std::vector<SourceFile> all = source_files(id);
  for (const SourceFile& part : all)
    if (!fs::is_regular_file(part.file)) {
      if (!fs::exists(part.file.parent_path())) static_cast<void>(frames());  // reports a missing data set
      throw InputError(part.file.string(), "", std::string("missing (") + part.what + " of the frame)",
                       "add the file or drop the frame");
    }
  return all;
}

std::optional<std::vector<int>> DataSet::tracks(const std::string& id) const {
  const auto [width, height] = picture_size(id);
  std::vector<int> all;
  for (const Label& label : annotations(id, width, height).labels) all.push_back(label.track);
  return all;
}

std::pair<int, int> DataSet::picture_size(const std::string& id) const {
  const PictureSize size = read_image_size(source_files(id).at(1).file);
  return {size.width, size.height};
}

Frame DataSet::read(const std::string& id) const {
  const std::vector<SourceFile> files = existing_files(id);
  Frame frame;
  frame.id = id;
  frame.sweep = sweep(id);
  // Header, calibration, pixels: an oversized header contradicts the calibration before it costs memory.
  const auto [width, height] = picture_size(id);
  Annotations result = annotations(id, width, height);
  frame.calibration = result.calibration;
  frame.image = read_srgb(files.at(1).file, {width, height});
  frame.labels = std::move(result.labels);
  frame.labelled = result.labelled;
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
    if (!other) continue;
    try {
      const auto at = moment(*other);
      // As nuScenes' devkit: frames further apart tell little about a velocity.
      if (!at || std::abs(at->time - frame.moment->time) > kMaxStep || at->time == frame.moment->time)
        continue;
      const PinholeCamera& camera = frame.calibration.camera;
      around.push_back({*at, annotations(*other, camera.width, camera.height).labels});
    } catch (const InputError&) {
      // A partial data set may lack the neighbour, or some of its files. Reading the neighbour reports that.
    }
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
  const std::vector<SourceFile> all = source_files(id);
  for (std::size_t i = 2; i < all.size(); ++i) hashes += file_hash(all[i].file, kMaxFileBytes);
  return hashes;
}

std::string DataSet::hash(const std::string& id) const {
  const std::vector<SourceFile> files = existing_files(id);
  std::string parts = file_hash(files.at(0).file, kMaxFileBytes) +
                      file_hash(files.at(1).file, kMaxFileBytes) + annotations_hash(id);
  if (const auto at = moment(id)) {
    parts += fmt::format(" {} {} {:.9f}", at->sequence, at->index, at->time);
    for (const double value : at->world_from_ego.matrix().topRows<3>().reshaped())
      parts += fmt::format(" {:.9g}", value);
  }
  return content_hash(parts);
}

std::string kitti_type(std::string_view name) {
  const char* result = known_type(name);
  return result != nullptr ? result : std::string(name);
}

bool is_known_type(std::string_view name) {
  return known_type(name) != nullptr;
}

bool is_vehicle_type(std::string_view type) {
  constexpr auto kVehicles = std::to_array<std::string_view>({"Car", "Van", "Truck", "Tram", "Bus"});
  return std::ranges::find(kVehicles, type) != kVehicles.end();
}

std::vector<std::string> classes_of(const std::string& list) {
  std::vector<std::string> classes;
  for (const std::string& name : listed_words(list)) classes.push_back(kitti_type(name));
  const auto blank = [](const std::string& name) { return name.find_first_not_of(" \t") == name.npos; };
  if (classes.empty() || std::ranges::any_of(classes, blank))
    throw FieldError("classes", list, "names no class", "give one or more, as Car,Van,Truck");
  return classes;
}

void mark_sought(const std::vector<std::string>& classes, std::vector<Label>& labels) {
  for (Label& label : labels) label.sought = std::ranges::find(classes, label.type) != classes.end();
}

std::string type_counts(const std::map<std::string, int>& types) {
  constexpr std::size_t kMax = 8, kMaxLength = 40;
  std::vector<std::pair<std::string, int>> sorted(types.begin(), types.end());
  std::ranges::stable_sort(sorted, std::greater<>(), &std::pair<std::string, int>::second);
  std::string text;
  for (std::size_t i = 0; i < std::min(kMax, sorted.size()); ++i)
    text +=
        fmt::format("{}{} {}", i == 0 ? "" : ", ", sorted[i].second, sorted[i].first.substr(0, kMaxLength));
  return sorted.size() > kMax ? fmt::format("{} and {} types more", text, sorted.size() - kMax) : text;
}

}  // namespace mirage
