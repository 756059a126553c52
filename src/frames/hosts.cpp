#include "frames/hosts.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <exception>

#include "base/error.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "scene/data/read_frames.h"

namespace mirage {

std::vector<HostId> host_ids(std::span<const Host> hosts) {
  std::vector<HostId> ids;
  for (const Host& host : hosts) ids.push_back(host.id);
  return ids;
}

int track_of(const FrameSource& source, const HostId& host) {
  const auto tracks = open_data_set(source.data, source.cameras)->tracks(host.frame);
  const auto label = as_size(host.label);
  return tracks && label < tracks->size() ? (*tracks)[label] : -1;
}

nlohmann::json to_json(const RoofCount& count) {
  return {{"fitted", count.fitted}, {"from_box", count.from_box}};
}

void SkippedHosts::add(LeftOut why) {
  no_room += why == LeftOut::no_room;
  no_neighbour += why == LeftOut::no_neighbour;
}

nlohmann::json to_json(const SkippedHosts& count) {
  return {{"no_room", count.no_room}, {"no_neighbour", count.no_neighbour}};
}

void warn_of_left_out(const PlaceChoice& place, const SkippedHosts& count) {
  if (count.no_room > 0)
    spdlog::warn("{} vehicles are left out: {}", count.no_room, why_left_out(place, LeftOut::no_room));
  if (count.no_neighbour > 0)
    spdlog::warn("{} vehicles are left out: {}", count.no_neighbour,
                 why_left_out(place, LeftOut::no_neighbour));
}

void refuse_left_out(const PlaceChoice& place, const SkippedHosts& count) {
  if (count.no_room + count.no_neighbour == 0) return;
  const LeftOut why = count.no_neighbour > count.no_room ? LeftOut::no_neighbour : LeftOut::no_room;
  throw FieldError("placement", text_of(place),
                   fmt::format("rules out {} vehicles, and no other one has the object in view: {}",
                               count.no_room + count.no_neighbour, why_left_out(place, why)),
                   "give another --place or more frames");
}

SkippedHosts leave_out(FrameStore& store, std::vector<HostId>& hosts) {
  SkippedHosts count;
  if (!store.place().of_file()) return count;  // only a placement from a file leaves hosts out
  std::erase_if(hosts, [&](const HostId& id) {
    const LeftOut why = store.placement(id).left_out;
    count.add(why);
    return why != LeftOut::no;
  });
  return count;
}

void require_hosted(const PlaceChoice& place, const Placement& placement, const HostId& host) {
  if (placement.left_out != LeftOut::no)
    throw InputError("host", host_name(host), why_left_out(place, placement.left_out),
                     "choose another vehicle, or another --place");
}

std::vector<Host> find_hosts(FrameStore& store, const std::string& frame, const std::array<double, 4>& region,
                             const SimulationSettings& simulation, double min_view, SkippedHosts* left_out) {
  std::vector<Host> hosts;
  for (const HostView& view : store.views(frame, region, simulation)) {
    if (left_out) left_out->add(view.left_out());
    if (view.share >= min_view) hosts.push_back({{frame, view.label}, view.from_box});
  }
  return hosts;
}

std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view, bool quiet, SkippedHosts* left_out) {
  std::vector<std::vector<Host>> by_frame(frames.size());
  std::vector<std::exception_ptr> problems(frames.size());
  Progress progress("look for hosts", frames.size(), quiet);
  std::vector<SkippedHosts> missed(frames.size());
  const std::vector<std::size_t> order = order_among_ranks(frames.size());
  parallel_for(frames.size(), [&](std::size_t k) {
    const std::size_t i = order[k];
    try {
      throw_if_interrupted("nothing was lost: no vehicle had been attacked yet");
      by_frame[i] = find_hosts(store, frames[i], region, simulation, min_view, &missed[i]);
    } catch (...) {
      problems[i] = std::current_exception();
    }
    progress.add();
  });
  for (const SkippedHosts& of : missed)
    if (left_out) left_out->no_room += of.no_room, left_out->no_neighbour += of.no_neighbour;
  for (const std::exception_ptr& problem : problems)  // the first frame's, whichever occurred first
    if (problem) std::rethrow_exception(problem);
  std::vector<Host> hosts;
  for (const auto& of_frame : by_frame) hosts.insert(hosts.end(), of_frame.begin(), of_frame.end());
  return hosts;
}

void split_frames(std::vector<std::string> frames, std::uint64_t seed, std::vector<std::string>& train,
                  std::vector<std::string>& test) {
  std::sort(frames.begin(), frames.end());
  RandomStream random(seed, "train test split");
  shuffle(frames, random);
  std::size_t n = as_size(std::lround(0.7 * static_cast<double>(frames.size())));
  if (frames.size() >= 2) n = std::clamp<std::size_t>(n, 1, frames.size() - 1);
  train.assign(frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(n));
  test.assign(frames.begin() + static_cast<std::ptrdiff_t>(n), frames.end());
  std::sort(train.begin(), train.end());
  std::sort(test.begin(), test.end());
}

}  // namespace mirage
