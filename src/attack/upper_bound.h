// How large a share can be at most, where few cars or none vanish: exact, one-sided.
#pragma once

#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "attack/host_outcome.h"

namespace mirage {

/// An exact upper bound of a mean of shares, one a cluster: the mean over all clusters, of which these were
/// drawn independently, is no larger with kConfidence, one-sided.
struct ShareBound {
  double value = 0, high = 1;
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

/// m: vehicles within it are what bounds are given for.
inline constexpr double kBoundRange = 40;
/// The share of cars within kBoundRange that vanish, as far as it can be excluded: each cluster
/// (base/clusters.h) weighs the same, so it is of a car drawn from a frame (or vehicle) drawn. With several
/// meshes a car counts as hidden if any of them hides it.
struct HiddenBound {
  ShareBound share;
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
HiddenBound hidden_bound(std::span<const HostOutcome> hosts);
/// "at most 5.1 % of cars within 40 m vanish (95 %, exact over 58 frames; seen: 0.0 %)", and where one can be
/// reached ": 149 frames for 2 %".
std::string describe(const HiddenBound& bound);
/// {at_most, value, within_m, vehicles, clusters: {by, count}, needed: [{at_most, clusters or null}]}
nlohmann::json to_json(const HiddenBound& bound);

}  // namespace mirage
