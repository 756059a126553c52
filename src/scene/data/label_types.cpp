#include "scene/data/label_types.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "base/fields.h"

namespace mirage {
namespace {

using Named = std::pair<std::string_view, const char*>;

/// By names in lower case. What has no box that anything can be said of is DontCare.
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
    // nuScenes' categories; a longer one is the part of it that stands here
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

/// The table's word; null if it has none.
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
    // "vehicle.foo" is no "vehicle": Waymo's word is a whole name.
    if (category && lower.find('.') == std::string::npos) return nullptr;
  }
}

}  // namespace

std::string kitti_type(std::string_view name) {
  const char* known = known_type(name);
  return known != nullptr ? known : std::string(name);
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

void seek(const std::vector<std::string>& classes, std::vector<Label>& labels) {
  for (Label& label : labels) label.sought = std::ranges::find(classes, label.type) != classes.end();
}

std::string type_counts(const std::map<std::string, int>& types) {
  constexpr std::size_t kMost = 8, kLongest = 40;
  std::vector<std::pair<std::string, int>> sorted(types.begin(), types.end());
  std::ranges::stable_sort(sorted, std::greater<>(), &std::pair<std::string, int>::second);
  std::string text;
  for (std::size_t i = 0; i < std::min(kMost, sorted.size()); ++i)
    text += fmt::format("{}{} {}", i == 0 ? "" : ", ", sorted[i].second, sorted[i].first.substr(0, kLongest));
  return sorted.size() > kMost ? fmt::format("{} and {} types more", text, sorted.size() - kMost) : text;
}

}  // namespace mirage
