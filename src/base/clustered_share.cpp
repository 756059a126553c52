#include "base/clustered_share.h"

namespace mirage {

void ClusteredShare::add(const std::string& cluster, double value) {
  ClusterSums& sums = clusters_[cluster];
  sums.numerator += value;
  sums.denominator += 1;
}

std::vector<ClusterSums> ClusteredShare::sums() const {
  std::vector<ClusterSums> list;
  for (const auto& [name, sums] : clusters_) list.push_back(sums);
  return list;
}

Interval ClusteredShare::signed_interval() const {
  Interval result = interval();
  if (result.value == 0 && result.low == 0) result.low = -result.high;
  return result;
}

}  // namespace mirage
