#include "validation/tradeoff/subjects.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "attack/adversary.h"
#include "base/error.h"
#include "scene/data/label_census.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr std::array<double, 4> kRegion = {0, 70, -40, 40};  // m, of the hosts: ahead, left
constexpr double kInView = 0.7;                              // share of the object that a host leaves in view

}  // namespace

Subjects choose_subjects(const TradeoffSettings& settings, const Run* run, FrameStore& store) {
  Subjects subjects;
  subjects.adversary = run ? run->adversary : random_adversary(settings.seed);
  std::vector<HostId> all;
  if (run) {
    all = run->test;
    all.insert(all.end(), run->train.begin(), run->train.end());
    all = evenly(all, static_cast<std::size_t>(4 * settings.hosts));
  } else {
    const auto frames = evenly(list_frames(settings.source.data), static_cast<std::size_t>(settings.frames));
    const LabelCensus census = count_labels(settings.source.data, frames);
    require_cars(census, "a trade-off");
    warn_of_labels(census);
    for (const Host& host : find_all_hosts(store, frames, kRegion, {}, kInView)) all.push_back(host.id);
  }
  if (all.empty())
    throw InputError(
        settings.source.data.string(), "label_2",
        fmt::format("no car with {:.0f} % of the object in view in the frames looked at", 100 * kInView),
        "give --frames 0 or another data set");
  const auto distance = [&](const HostId& id) {
    const auto held = store.get(id.frame);
    const BevBox& box = label_of(held->frame, id).box.bev;
    return std::hypot(box.x, box.y);
  };
  std::stable_sort(all.begin(), all.end(),
                   [&](const HostId& a, const HostId& b) { return distance(a) < distance(b); });
  subjects.hosts = evenly(all, static_cast<std::size_t>(settings.hosts));
  return subjects;
}

}  // namespace mirage
