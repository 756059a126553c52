#include "scene/data/read_frames.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "base/error.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "scene/data/layouts.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

/// Whether the id's files exist; also for a sweep between labelled frames, which frames() leaves out.
bool has_files_of(const DataSet& set, const std::string& id) {
  try {
    const auto files = set.source_files(id);
    return fs::exists(files.at(0).file) || fs::exists(files.at(1).file);
  } catch (const InputError&) {
    return false;
  }
}

/// InputError, naming the nearest frames, if the set has no such frame.
void require_frame(const fs::path& data, const DataSet& set, const std::string& id) {
  constexpr std::size_t kNamed = 10;
  std::vector<std::string> frames;
  try {
    frames = set.frames();
  } catch (const InputError&) {  // the set has no frames
  }
  if (frames.empty() || std::ranges::find(frames, id) != frames.end() || has_files_of(set, id)) return;
  std::stable_sort(frames.begin(), frames.end(), [&](const std::string& a, const std::string& b) {
    return edit_distance(id, a) < edit_distance(id, b);
  });
  const std::size_t count = frames.size();
  if (count > kNamed) frames.resize(kNamed);
  throw InputError(
      data.string(), "frame " + id, "no such frame",
      use_one_of(id, frames, count > kNamed ? fmt::format("another of its {} frames", count) : ""));
}

struct NumberRange {
  int first = 0, last = std::numeric_limits<int>::max();
};

std::optional<NumberRange> range_of(const std::string& text) {
  NumberRange range;
  if (text.empty()) return range;
  const std::size_t colon = text.find(':');
  if (colon == text.npos) return std::nullopt;
  const auto read = [](std::string_view end, int& value) {
    if (!end.empty()) value = try_parse_number<int>(end).value_or(-1);
    return value >= 0;
  };
  const std::string_view ends = text;
  if (!read(ends.substr(0, colon), range.first) || !read(ends.substr(colon + 1), range.last) ||
      range.first > range.last)
    return std::nullopt;
  return range;
}

/// "0 of 41 labelled objects count as a Car: 41 vehicle.foo".
std::string unusable_labels_text(const LabelCensus& census) {
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

/// InputError for a class that is neither known nor in the data.
void check_classes(const LabelCensus& census) {
  std::vector<std::string> there;
  for (const auto& [type, count] : census.types) there.push_back(type);
  for (const std::string& name : census.classes)
    if (!is_known_type(name) && !census.types.contains(name)) throw unknown_word("classes", name, there);
}

}  // namespace

std::shared_ptr<const DataSet> open_data_set(const fs::path& data, Cameras cameras) {
  std::shared_ptr<const DataSet> set;
  for (const auto open : {open_separate_labels, open_nuscenes, open_kitti_raw, open_kitti_tracking})
    if (!set) set = open(data);
  if (!set) set = open_kitti_object(data);
  if (cameras == Cameras::all)
    if (auto whole = set->with_all_cameras()) return whole;
  return set;
}

std::vector<std::string> list_frames(const fs::path& data, std::size_t limit) {
  std::vector<std::string> ids = open_data_set(data)->frames();
  if (limit > 0 && ids.size() > limit) ids.resize(limit);
  return ids;
}

Frame read_frame(const fs::path& data, const std::string& id, Cameras cameras) {
  const auto set = open_data_set(data, cameras);
  try {
    return set->read(id);
  } catch (const InputError&) {
    require_frame(data, *set, id);  // for a misspelt id this error tells more than the missing file's
    throw;
  }
}

Annotations read_annotations(const fs::path& data, const std::string& id, Cameras cameras) {
  const auto set = open_data_set(data, cameras);
  const auto [width, height] = set->picture_size(id);
  return set->annotations(id, width, height);
}

void check_frame_range(const std::string& frames) {
  if (!range_of(frames))
    throw FieldError("frames", frames, "is not a range of frame numbers", "give it as 20:80, 20: or :80");
}

std::vector<Sequence> read_sequences(const std::filesystem::path& data, const SequencePart& part) {
  check_frame_range(part.frames);
  const NumberRange range = *range_of(part.frames);
  const auto set = open_data_set(data);
  std::map<std::string, Sequence> sequences;
  for (const std::string& id : part.between ? set->sweeps() : set->frames()) {
    const auto moment = set->moment(id);
    if (!moment) continue;
    Sequence& sequence = sequences[moment->sequence];
    sequence.name = moment->sequence;
    sequence.frames.push_back({id, *moment});
  }
  if (sequences.empty())
    throw InputError(data.string(), "", "says of no frame when it was taken and where the car stood",
                     "give KITTI's tracking benchmark with training/oxts, its raw recordings with "
                     "calib_imu_to_velo.txt and oxts, or nuScenes");
  if (!part.sequence.empty() && !sequences.contains(part.sequence)) {
    std::vector<std::string> names;
    for (const auto& [name, sequence] : sequences) names.push_back(name);
    throw unknown_word("sequence", part.sequence, names);
  }
  std::vector<Sequence> all;
  for (auto& [name, sequence] : sequences) {
    if (!part.sequence.empty() && name != part.sequence) continue;
    auto& frames = sequence.frames;
    std::erase_if(frames, [&](const SequenceFrame& frame) {
      return frame.moment.index < range.first || frame.moment.index > range.last;
    });
    std::stable_sort(frames.begin(), frames.end(),
                     [](const auto& a, const auto& b) { return a.moment.time < b.moment.time; });
    const auto twice = std::adjacent_find(frames.begin(), frames.end(), [](const auto& a, const auto& b) {
      return a.moment.time == b.moment.time;
    });
    if (twice != frames.end())
      throw InputError(data.string(), "frame " + std::next(twice)->id,
                       "was taken at the time of " + twice->id, "restore the recording's times");
    const auto back = std::adjacent_find(frames.begin(), frames.end(), [](const auto& a, const auto& b) {
      return a.moment.index > b.moment.index;
    });
    if (back != frames.end())
      throw InputError(data.string(), "frame " + back->id,
                       "was taken before " + std::next(back)->id + ", which has the smaller number",
                       "restore the recording's times");
    if (!frames.empty()) all.push_back(std::move(sequence));
  }
  if (all.empty())
    throw InputError(data.string(), "frames", "no sequence has a frame of the numbers " + part.frames,
                     "give another range");
  return all;
}

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
  for (Annotations& result : all) {
    census.unlabelled += !result.labelled;
    census.notes.clipped += result.notes.clipped;
    census.notes.projected += result.notes.projected;
    mark_sought(census.classes, result.labels);
    for (const Label& label : result.labels) {
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
    spdlog::warn(
        "{}: {} of {} frames have no labels: they are not scored, and none of their vehicles is a host", data,
        census.unlabelled, census.frames);
  const auto unknown = unknown_types(census);
  if (census.unlabelled < census.frames && sought(census) == 0)
    spdlog::warn("{}: {}{}{}", data, unusable_labels_text(census), unknown.empty() ? "" : "; known are ",
                 unknown.empty() ? "" : kKnownTypes);
  else if (!unknown.empty())
    spdlog::warn("{}: labels of unknown types are ignored: {}; known types: {}", data, type_counts(unknown),
                 kKnownTypes);
  if (census.in_picture_alone > 0)
    spdlog::warn(
        "{}: {} of {} labels have only a box in the picture, so they count only for picture detectors", data,
        census.in_picture_alone, census.labels);
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
  refuse(unusable_labels_text(census), unknown_types(census).empty()
                                           ? "label the cars"
                                           : fmt::format("call cars Car: known are {}", kKnownTypes));
}

LabelCensus check_labels(const std::filesystem::path& data, std::span<const std::string> ids,
                         const std::string& work, const std::string& classes, Cameras cameras) {
  LabelCensus census = count_labels(data, ids, classes, cameras);
  require_cars(census, work);
  if (rank() == 0) warn_of_labels(census);
  return census;
}

void require_types(const LabelCensus& census, std::span<const std::string> types, const std::string& option) {
  if (census.unlabelled == census.frames) return require_cars(census, "a fit");
  const bool some =
      std::ranges::any_of(types, [&](const std::string& type) { return census.types.contains(type); });
  if (some) return;
  throw InputError(option, fmt::format("{}", fmt::join(types, " ")),
                   census.labels == 0 ? unusable_labels_text(census)
                                      : fmt::format("no label of {} has this type; there are {}",
                                                    census.data.string(), type_counts(census.types)),
                   "give one of the types found");
}

}  // namespace mirage
