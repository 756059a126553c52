#include "scene/data/sequences.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <limits>
#include <map>
#include <optional>

#include "base/error.h"
#include "base/words.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

struct NumberRange {
  int first = 0, last = std::numeric_limits<int>::max();
};

std::optional<NumberRange> range_of(const std::string& text) {
  NumberRange range;
  if (text.empty()) return range;
  const std::size_t colon = text.find(':');
  if (colon == text.npos) return std::nullopt;
  const auto read = [](const char* from, const char* to, int& value) {
    if (from == to) return true;
    const auto [end, error] = std::from_chars(from, to, value);
    return error == std::errc() && end == to && value >= 0;
  };
  const char* begin = text.data();
  if (!read(begin, begin + colon, range.first) || !read(begin + colon + 1, begin + text.size(), range.last) ||
      range.first > range.last)
    return std::nullopt;
  return range;
}

}  // namespace

void check_frame_range(const std::string& frames) {
  if (!range_of(frames))
    throw FieldError("frames", frames, "is no range of frame numbers", "give it as 20:80, 20: or :80");
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
    if (!frames.empty()) all.push_back(std::move(sequence));
  }
  if (all.empty())
    throw InputError(data.string(), "frames", "no sequence has a frame of the numbers " + part.frames,
                     "give another range");
  return all;
}

}  // namespace mirage
