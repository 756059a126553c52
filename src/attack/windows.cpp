#include "attack/windows.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <numeric>
#include <utility>

#include "base/fields.h"
#include "base/random.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr double kSameTime = 1e-6;  // s: 0.6 − 0.1 is less than 0.5 in binary

/// The first host that is a window after host `first`; the track's size where none is in reach.
std::size_t shortest_end(const std::vector<HostAt>& track, std::size_t first) {
  std::size_t end = first;
  while (end < track.size() && track[end].time < track[first].time + kShortestWindow - kSameTime) ++end;
  const bool near = end < track.size() && track[end].time <= track[first].time + kLongestWindow + kSameTime;
  return near ? end : track.size();
}

std::vector<std::size_t> starts(const std::vector<HostAt>& track) {
  std::vector<std::size_t> starts;
  for (std::size_t i = 0; i < track.size(); ++i)
    if (shortest_end(track, i) < track.size()) starts.push_back(i);
  return starts;
}

}  // namespace

std::vector<std::vector<HostAt>> followed(const std::filesystem::path& data, std::span<const Host> hosts) {
  const auto set = open_data_set(data);
  std::map<std::pair<std::string, int>, std::vector<HostAt>> tracks;
  for (std::size_t i = 0; i < hosts.size(); ++i) {
    const auto moment = set->moment(hosts[i].id.frame);
    const int track = moment ? track_of(data, hosts[i].id) : -1;
    if (track >= 0) tracks[{moment->sequence, track}].push_back({i, moment->time});
  }
  std::vector<std::vector<HostAt>> all;
  for (auto& [vehicle, track] : tracks) {
    std::stable_sort(track.begin(), track.end(),
                     [](const HostAt& a, const HostAt& b) { return a.time < b.time; });
    all.push_back(std::move(track));
  }
  if (std::all_of(all.begin(), all.end(), [](const auto& track) { return starts(track).empty(); }))
    throw FieldError(
        "objective", "gap",
        fmt::format("no training vehicle of {} is followed through {} s{}", data.string(), kShortestWindow,
                    all.empty() ? ": its frames are of no sequence, or its labels have no identities" : ""),
        all.empty()
            ? "give KITTI's tracking benchmark with training/oxts, nuScenes or generated --drives, or "
              "use frame"
            : "give longer drives, lower --min-view, or use frame");
  return all;
}

WindowOrder::WindowOrder(std::vector<std::vector<HostAt>> tracks, int batch, std::uint64_t seed)
    : batch_(static_cast<std::size_t>(batch)), seed_(seed), tracks_(std::move(tracks)) {
  std::erase_if(tracks_, [](const auto& track) { return starts(track).empty(); });
}

std::vector<std::size_t> WindowOrder::batch(long iteration) const {
  const auto count = static_cast<long>(tracks_.size());
  RandomStream order(seed_, "order of vehicles", static_cast<std::uint64_t>(iteration / count));
  std::vector<std::size_t> vehicles(tracks_.size());
  std::iota(vehicles.begin(), vehicles.end(), std::size_t{0});
  shuffle(vehicles, order);
  const std::vector<HostAt>& track = tracks_[vehicles[static_cast<std::size_t>(iteration % count)]];

  RandomStream random(seed_, "window", static_cast<std::uint64_t>(iteration));
  const double length = random.uniform(kShortestWindow, kLongestWindow);
  const auto from = starts(track);
  const std::size_t first = from[static_cast<std::size_t>(random.below(static_cast<int>(from.size())))];
  std::size_t last = shortest_end(track, first);
  while (last + 1 < track.size() && track[last + 1].time <= track[first].time + length) ++last;
  const std::size_t steps = std::max<std::size_t>(1, std::min(batch_ - 1, last - first));
  std::vector<std::size_t> hosts;
  for (std::size_t k = 0; k <= steps; ++k) hosts.push_back(track[first + k * (last - first) / steps].host);
  return hosts;
}

}  // namespace mirage
