#include "base/clusters.h"

#include <fmt/format.h>

#include <climits>

#include "base/intervals.h"

namespace mirage {

std::string cluster_of(const std::string& frame, int track) {
  return track < 0 ? frame : "vehicle " + std::to_string(track);
}

void Clusters::add(const std::string& frame, int track) {
  by_vehicle_ = by_vehicle_ || track >= 0;
  names_.insert(cluster_of(frame, track));
}

ClusterCount Clusters::count() const {
  return {by_vehicle_ ? "vehicle" : "frame", static_cast<int>(names_.size())};
}

std::string to_string(const ClusterCount& clusters) {
  const std::string count =
      fmt::format("{} {}{}", clusters.count, clusters.by, clusters.count == 1 ? "" : "s");
  return clusters.count < kFewClusters ? count + " only: intervals are wide and approximate" : count;
}

nlohmann::json to_json(const ClusterCount& clusters) {
  return {{"by", clusters.by}, {"count", clusters.count}};
}

ClusterCount cluster_count_from_json(const JsonFields& fields) {
  return {fields.text("by"), fields.count("count")};
}

}  // namespace mirage
