#include "attack/success_rates.h"

#include "attack/cluster_shares.h"

namespace mirage {

SuccessRates success_rates(std::span<const HostOutcome* const> hosts, std::optional<double> iou) {
  ClusterShares shares(3);
  for (const HostOutcome* host : hosts) {
    if (!(iou ? host->clean_iou > *iou : host->detected)) continue;
    const bool hidden = iou ? host->attacked_iou <= *iou : host->hidden;
    auto& sums = shares.count(*host);
    sums[0] += hidden;
    sums[1] += host->false_positive;
    sums[2] += hidden || host->false_positive;
  }
  const std::vector<Interval> rates = shares.intervals();
  return {rates[0], rates[1], rates[2]};
}

}  // namespace mirage
