// A share of things that come in clusters (base/clusters.h): counted here, drawn in base/bootstrap.h.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "base/bootstrap.h"

namespace mirage {

/// Σ of values over how many there were, by cluster.
class ClusteredShare {
 public:
  /// Counts one thing of the cluster: 1 or true where it has what is asked, 0 where not; or any number whose
  /// mean is wanted.
  void add(const std::string& cluster, double value);
  /// A cluster that was looked at, though nothing of it may count.
  void note(const std::string& cluster) { clusters_[cluster]; }
  /// The sums in the order of the clusters' names, and by name.
  std::vector<ClusterSums> sums() const;
  const std::map<std::string, ClusterSums>& by_name() const { return clusters_; }
  /// bootstrap_interval() of the sums.
  Interval interval() const { return bootstrap_interval(sums()); }
  /// Of a difference of shares: one without any difference may go either way.
  Interval signed_interval() const;

 private:
  std::map<std::string, ClusterSums> clusters_;
};

}  // namespace mirage
