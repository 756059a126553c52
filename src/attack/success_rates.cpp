#include "attack/success_rates.h"

#include <algorithm>

namespace mirage {

SuccessRates success_rates(std::span<const HostOutcome* const> hosts, std::optional<double> iou) {
  ClusteredShare fn, fp, either;
  int meshes = 1;
  for (const HostOutcome* host : hosts) meshes = std::max(meshes, host->mesh + 1);
  for (const HostOutcome* host : hosts) {
    if (!(iou ? host->clean_iou > *iou : host->detected)) continue;
    const bool hidden = iou ? host->attacked_iou <= *iou : host->hidden;
    fn.add(host->cluster(), hidden, 0, 1.0 / meshes);
    fp.add(host->cluster(), host->false_positive, 0, 1.0 / meshes);
    either.add(host->cluster(), hidden || host->false_positive, 0, 1.0 / meshes);
  }
  return {fn.interval(), fp.interval(), either.interval()};
}

}  // namespace mirage
