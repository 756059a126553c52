// Host vehicles: which cars of which frames can carry the adversary, and their split.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "detection/detector.h"
#include "frames/frame_store.h"
#include "frames/host_id.h"
#include "simulation/insertion.h"

namespace mirage {

/// A vehicle and how its roof was found.
struct Host {
  HostId id;
  bool from_box = true;  ///< Carrier::from_box
};

/// The hosts' ids, in the same order.
std::vector<HostId> host_ids(std::span<const Host> hosts);

/// Counts of the vehicles that the placement leaves out (LeftOut).
struct SkippedHosts {
  int no_room = 0, no_neighbour = 0;
  /// Counts a vehicle; LeftOut::no counts nothing.
  void add(LeftOut why);
};
/// {"no_room": N, "no_neighbour": N}
nlohmann::json to_json(const SkippedHosts& count);
/// Warns of vehicles left out, if any.
void warn_of_left_out(const PlaceChoice& place, const SkippedHosts& count);
/// For a run without hosts: FieldError if the placement left any out.
void refuse_left_out(const PlaceChoice& place, const SkippedHosts& count);

/// Vehicles of the frame that can be hosts: of a class sought (Car by default), box centre inside the
/// detector's region, and at least `min_view` of the reference adversary in view after occlusion. `left_out`,
/// unless null, counts the vehicles that the placement leaves out, in view or not.
std::vector<Host> find_hosts(FrameStore& store, const std::string& frame, const std::array<double, 4>& region,
                             const SimulationSettings& simulation, double min_view = 0.7,
                             SkippedHosts* left_out = nullptr);

/// Hosts of every frame of a data set. Shows progress unless `quiet`.
std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view, bool quiet = true, SkippedHosts* left_out = nullptr);

/// Removes the hosts that the store's placement leaves out, and counts them.
SkippedHosts leave_out(FrameStore& store, std::vector<HostId>& hosts);
/// InputError, naming the host, if the placement leaves it out.
void require_hosted(const PlaceChoice& place, const Placement& placement, const HostId& host);

/// The vehicle's track id in its data set; −1 if the set has none.
int track_of(const FrameSource& source, const HostId& host);

/// How the roofs of a run's hosts were found.
struct RoofCount {
  int fitted = 0, from_box = 0;
  /// Counts one roof.
  void add(bool is_from_box) { ++(is_from_box ? from_box : fitted); }
};
/// {"fitted": N, "from_box": N}
nlohmann::json to_json(const RoofCount& count);

/// Splits frames (not hosts) train : test = 7 : 3 at random by seed. At least one frame each when there are
/// two.
void split_frames(std::vector<std::string> frames, std::uint64_t seed, std::vector<std::string>& train,
                  std::vector<std::string>& test);

}  // namespace mirage
