// Shares over hosts whose intervals come from a bootstrap over clusters (base/clusters.h).
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "attack/host_outcome.h"
#include "base/bootstrap.h"
#include "base/clusters.h"

namespace mirage {

/// Sums of several shares by cluster, and their intervals from the same draws.
class ClusterShares {
 public:
  explicit ClusterShares(std::size_t shares) : shares_(shares) {}
  /// Counts `host` once; returns its cluster's sums.
  std::vector<double>& count(const HostOutcome& host) {
    auto& [hosts, sums] = clusters_[cluster_of(host.id.frame, host.track)];
    hosts += 1;
    sums.resize(shares_);
    return sums;
  }
  std::vector<Interval> intervals() const {
    std::vector<double> denominators;
    std::vector<std::vector<double>> numerators(shares_);
    for (const auto& [cluster, counted] : clusters_) {
      denominators.push_back(counted.first);
      for (std::size_t k = 0; k < shares_; ++k) numerators[k].push_back(counted.second[k]);
    }
    return bootstrap_intervals(denominators, numerators);
  }

 private:
  std::size_t shares_;
  std::map<std::string, std::pair<double, std::vector<double>>> clusters_;
};

}  // namespace mirage
