// Confidence intervals where the same vehicles stand in several runs of one experiment (attacks learned from
// different seeds): how well an attack does depends on both, so both are drawn, and what is of one cluster in
// one run counts as often as the product of how often the two are drawn (the pigeonhole bootstrap: Owen, The
// Annals of Applied Statistics 1, 2007, section 4). Clusters: base/bootstrap.h. Not every cluster needs to
// stand in every run.
//
// Of R runs R − 1 are drawn: R draws would have the spread of R − 1 runs' mean times (R − 1) / R, half of it
// for two (Rao and Wu, JASA 83, 1988, section 2.2). That mends the variance, not the tails: percentiles over
// three runs know nothing of Student's t, and five are few.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/bootstrap.h"

namespace mirage {

/// Which cluster and which run something is of; both from 0 without gaps.
struct Crossing {
  std::size_t cluster = 0, run = 0;
};

/// Cluster by name, and run by number.
using CrossingName = std::pair<std::string, int>;

/// Crossings of a map's keys, in its order; clusters and runs are numbered in theirs.
std::vector<Crossing> crossings_of(std::span<const CrossingName> names);
template <class T>
std::vector<Crossing> crossings(const std::map<CrossingName, T>& sums) {
  std::vector<CrossingName> names;
  for (const auto& [name, value] : sums) names.push_back(name);
  return crossings_of(names);
}

/// As bootstrap_statistic; `statistic` gets how often each item is drawn. With a single run, where the items
/// are the clusters, the same to the bit.
Interval crossed_statistic(std::span<const Crossing> items,
                           const std::function<double(std::span<const int> drawn)>& statistic,
                           const BootstrapSettings& settings = {});

/// As bootstrap_interval: Σ numerators / Σ denominators. Where every item has the same ratio, that of the
/// clusters over all runs: more runs show no more vehicles.
Interval crossed_interval(const std::map<CrossingName, ClusterSums>& sums,
                          const BootstrapSettings& settings = {});

/// As bootstrap_difference. Runs of equal number are drawn together: what two arms share by their seed (who
/// is held back) is paired; where they share nothing that costs nothing.
Interval crossed_difference(const std::map<CrossingName, PairedSums>& sums,
                            const BootstrapSettings& settings = {});

}  // namespace mirage
