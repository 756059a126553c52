// How large a share can be at most, where few cars or none vanish, and at least: exact, one-sided. And how
// many vehicles it takes to tell more.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/host_outcome.h"

namespace mirage {

/// Exact bounds of a mean of shares, one a cluster: the mean over all clusters, of which these were drawn
/// independently, is no larger than `high` with kConfidence, and no smaller than `low` with kConfidence.
struct ShareBound {
  double value = 0, low = 0, high = 1;
  int clusters = 0;
  /// No cluster has more than one trial. Then the bound is the binomial's (Clopper and Pearson, Biometrika
  /// 26, 1934). Else it is that at (1 − kConfidence) / e, at the next whole number of clusters: for any
  /// independent numbers in [0, 1] the lower tail of their sum is at most e times the binomial's (Bentkus,
  /// Annals of Probability 32, 2004).
  bool single = true;
};
/// `shares` in [0, 1]. Without any: [0, 1].
ShareBound share_bound(std::span<const double> shares, bool single);
/// About how many clusters of that kind would bound the mean by `at_most`, if the share seen stays `value`;
/// infinite where that is not below `at_most`.
double clusters_for(double at_most, double value, bool single);
/// A plan's number of vehicles, rounded up to two digits; none above a million, and for no number.
std::optional<long> planned(double wanted);
/// How many it would take to tell `difference`, where `vehicles` tell `detectable` in as many of such sets:
/// intervals narrow with their root.
std::optional<long> vehicles_to_tell(double vehicles, double detectable, double difference);

/// m: vehicles within it are what bounds are given for, unless others are asked for.
inline constexpr double kBoundRange = 40;
/// The share of cars at these distances that vanish, as far as it can be excluded: each cluster
/// (base/clusters.h) weighs the same, so it is of a car drawn from a frame (or vehicle) drawn. With several
/// meshes a car counts as hidden if any of them hides it.
struct HiddenBound {
  ShareBound share;
  double nearest = 0, farthest = kBoundRange;  ///< m; the nearer end belongs to it
  int vehicles = 0;
  std::string by = "frame";  ///< ClusterCount::by
  /// What a smaller bound would take, if the share seen stays.
  struct Needed {
    double at_most;
    double clusters;  ///< infinite: the share seen is not below it
  };
  std::vector<Needed> needed;  ///< for 10, 5, 2 and 1 %
};
/// Over outcomes of one mesh or of several.
HiddenBound hidden_bound(std::span<const HostOutcome> hosts, double nearest = 0,
                         double farthest = kBoundRange);
/// "at most 5.1 % of cars within 40 m vanish (95 %, exact over 58 frames; seen: 0.0 %)", and where one can be
/// reached ": 149 frames for 2 %".
std::string describe(const HiddenBound& bound);
/// {at_most, at_least, value, from_m, within_m, vehicles, clusters: {by, count}, needed: [{at_most, clusters
/// or null}]}
nlohmann::json to_json(const HiddenBound& bound);

}  // namespace mirage
