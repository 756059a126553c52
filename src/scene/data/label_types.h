// Names of classes: KITTI's types, and which of them other data sets' names mean.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "scene/frame.h"

namespace mirage {

/// KITTI's word for a class by the name that KITTI, nuScenes (category or detection name), Waymo or Argoverse
/// (1 and 2) has for it, whatever its case: "vehicle.bus.rigid" is "Bus", which KITTI has no word for. A name
/// that the table lacks comes back as it is. KITTI's development kit compares types without case, too.
std::string kitti_type(std::string_view name);
/// Whether the table has the name.
bool is_known_type(std::string_view name);
/// Whether it is the type of a motor vehicle: Car, Van, Truck, Tram or Bus.
bool is_vehicle_type(std::string_view type);

/// The classes that a list of names says ("Car,Van,truck"), each as kitti_type has it. FieldError for a list
/// that names none.
std::vector<std::string> classes_of(const std::string& list);
/// Marks the labels of these classes as sought, and the others as not (Label::sought).
void seek(const std::vector<std::string>& classes, std::vector<Label>& labels);
/// Classes where nobody asks for others.
inline constexpr const char* kCars = "Car";
inline constexpr const char* kClassesHelp =
    "classes of the labels that carry the object and have to be found, as Car,Van,Truck";

/// Counts of labels by type: "41 vehicle.foo, 3 Pedestrian", the most frequent first, at most eight of them.
std::string type_counts(const std::map<std::string, int>& types);
/// What types are known, for messages.
inline constexpr const char* kKnownTypes =
    "KITTI's types (Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc, DontCare) and the "
    "class "
    "names of nuScenes, Waymo and Argoverse";

}  // namespace mirage
