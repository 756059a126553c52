#include "scene/data/label_census.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "base/error.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/words.h"
#include "scene/data/label_types.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

/// "0 of 41 labelled vehicles count: 41 vehicle.foo".
std::string none_counts(const LabelCensus& census) {
  return census.labels == 0
             ? fmt::format("the labels of {} frames hold no object", census.frames - census.unlabelled)
             : fmt::format("0 of {} labelled objects count as a {}: {}", census.labels,
                           fmt::join(census.classes, " or "), type_counts(census.types));
}

std::map<std::string, int> unknown_types(const LabelCensus& census) {
  std::map<std::string, int> unknown;
  for (const auto& [type, count] : census.types)
    if (!is_known_type(type)) unknown[type] = count;
  return unknown;
}

int sought(const LabelCensus& census) {
  int count = 0;
  for (const std::string& name : census.classes)
    if (const auto of = census.types.find(name); of != census.types.end()) count += of->second;
  return count;
}

/// InputError for a class that neither anybody knows nor the data have.
void check_classes(const LabelCensus& census) {
  std::vector<std::string> there;
  for (const auto& [type, count] : census.types) there.push_back(type);
  for (const std::string& name : census.classes)
    if (!is_known_type(name) && !census.types.contains(name)) throw unknown_word("classes", name, there);
}

}  // namespace

LabelCensus count_labels(const std::filesystem::path& data, std::span<const std::string> ids,
                         const std::string& classes, Cameras cameras) {
  const auto set = open_data_set(data, cameras);
  std::vector<Annotations> all(ids.size());
  parallel_for(ids.size(), [&](std::size_t i) {
    const auto [width, height] = set->picture_size(ids[i]);
    all[i] = set->annotations(ids[i], width, height);
  });
  LabelCensus census;
  census.classes = classes_of(classes);
  census.data = data;
  census.incomplete = set->incomplete();
  census.frames = ids.size();
  for (Annotations& known : all) {
    census.unlabelled += !known.labelled;
    census.notes.clipped += known.notes.clipped;
    census.notes.projected += known.notes.projected;
    seek(census.classes, known.labels);
    for (const Label& label : known.labels) {
      if (label.type == "DontCare") continue;
      ++census.labels;
      ++census.types[label.type];
      census.in_picture_alone += !label.in_space;
      census.cars += is_sought(label) && has_box(label);
    }
  }
  check_classes(census);
  return census;
}

void warn_of_labels(const LabelCensus& census) {
  const std::string data = census.data.string();
  if (!census.incomplete.empty()) spdlog::warn("{}: {}", data, census.incomplete);
  if (census.unlabelled > 0)
    spdlog::warn("{}: {} of {} frames have no labels: nothing is scored in them, and no vehicle is a host",
                 data, census.unlabelled, census.frames);
  const auto unknown = unknown_types(census);
  if (census.unlabelled < census.frames && sought(census) == 0)
    spdlog::warn("{}: {}{}{}", data, none_counts(census), unknown.empty() ? "" : "; known are ",
                 unknown.empty() ? "" : kKnownTypes);
  else if (!unknown.empty())
    spdlog::warn("{}: labels of unknown types count for nothing: {}; known are {}", data,
                 type_counts(unknown), kKnownTypes);
  if (census.in_picture_alone > 0)
    spdlog::warn(
        "{}: {} of {} labels have a box in the picture alone: they count for detectors of the picture alone",
        data, census.in_picture_alone, census.labels);
  if (census.notes.clipped > 0)
    spdlog::warn("{}: {} labels' boxes in the picture reach past its edge, and were clipped", data,
                 census.notes.clipped);
  if (census.notes.projected > 0)
    spdlog::warn("{}: {} labels have no box in the picture, which is projected from their box in space", data,
                 census.notes.projected);
}

void require_cars(const LabelCensus& census, const std::string& work) {
  if (census.cars > 0) return;
  const auto refuse = [&](const std::string& problem, const std::string& fix) {
    throw InputError(census.data.string(), "labels", problem, fix);
  };
  if (census.unlabelled == census.frames)
    refuse(fmt::format("none of the {} frames has any, and {} needs labelled cars", census.frames, work),
           "add them; view, detect --kitti and attack --hosts-from detections work without");
  if (sought(census) > 0)
    refuse(fmt::format("all {} cars have a box in the picture alone, and {} needs boxes in space",
                       sought(census), work),
           "give labels in 3-D; mirage detect --detector camera is scored on these");
  refuse(none_counts(census), unknown_types(census).empty()
                                  ? "label the cars"
                                  : fmt::format("call cars Car: known are {}", kKnownTypes));
}

void require_types(const LabelCensus& census, std::span<const std::string> types, const std::string& option) {
  if (census.unlabelled == census.frames) return require_cars(census, "a fit");
  const bool some =
      std::ranges::any_of(types, [&](const std::string& type) { return census.types.contains(type); });
  if (some) return;
  throw InputError(option, fmt::format("{}", fmt::join(types, " ")),
                   census.labels == 0 ? none_counts(census)
                                      : fmt::format("no label of {} has this type; there are {}",
                                                    census.data.string(), type_counts(census.types)),
                   "give one of the types found");
}

}  // namespace mirage
