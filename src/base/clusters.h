// Items by their group.
#pragma once

#include <cstddef>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "base/json_fields.h"

namespace mirage {

/// Brings the items of each group together, in the order in which they were. Returns where each group's
/// start, and past the last. group_of(item): in [0, groups).
template <class Item, class GroupOf>
std::vector<int> group_together(std::vector<Item>& items, std::size_t groups, const GroupOf& group_of) {
  std::vector<int> first(groups + 1, 0);
  for (const Item& item : items) ++first[static_cast<std::size_t>(group_of(item)) + 1];
  for (std::size_t i = 1; i < first.size(); ++i) first[i] += first[i - 1];
  std::vector<Item> grouped(items.size());
  std::vector<int> next(first.begin(), first.end() - 1);
  for (const Item& item : items)
    grouped[static_cast<std::size_t>(next[static_cast<std::size_t>(group_of(item))]++)] = item;
  items = std::move(grouped);
  return first;
}

// Which observations an interval (base/intervals.h) takes together, for every command.
//
// A drive's frames show the same cars again and again, so boxes are no independent trials. Where the data set
// says who is who (training/track_2, scene/data/kitti.h) all that is seen of one vehicle, in whatever frames,
// is one cluster; boxes of unknown identity, and what belongs to no vehicle at all (a detector's false
// alarms), go with their frame. A data set without identities has its frames for clusters.
//
// Frames that share a vehicle are not merged into one cluster. Along a drive all of them would be (25 frames
// in a row are connected through their cars), and a single cluster has no spread to estimate from. What a
// frame does to all its vehicles alike is therefore not in the interval of a set with identities.

/// Name of the cluster of something seen in `frame`. `track`: the vehicle's identity; negative: unknown, or
/// of no vehicle. Without identities the names are the frames', in their order.
std::string cluster_of(const std::string& frame, int track);

/// What an interval rests on.
struct ClusterCount {
  std::string by = "frame";  ///< "vehicle" once an identity was known
  int count = 0;             ///< clusters that hold anything that counts
};

/// Collects the clusters of what counts, to say what an interval rests on.
class Clusters {
 public:
  /// Something that counts was seen; arguments as cluster_of's.
  void add(const std::string& frame, int track);
  /// The different clusters so far.
  ClusterCount count() const;

 private:
  bool by_vehicle_ = false;
  std::set<std::string> names_;
};

/// "42 frames"; under kFewClusters (base/intervals.h) "7 frames only: intervals are wide and approximate".
std::string to_string(const ClusterCount& clusters);
/// {"by": "vehicle" or "frame", "count": N}
nlohmann::json to_json(const ClusterCount& clusters);
/// Its inverse. InputError, naming file and field, for anything else.
ClusterCount cluster_count_from_json(const JsonFields& fields);

}  // namespace mirage
