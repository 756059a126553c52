#include <algorithm>
#include <cmath>

#include "detection/detector.h"

namespace mirage {

double Proposal::score() const {
  return logit >= 0 ? 1 / (1 + std::exp(-logit)) : std::exp(logit) / (1 + std::exp(logit));
}

std::vector<Proposal> suppress(std::vector<Proposal> proposals, double max_iou) {
  std::stable_sort(proposals.begin(), proposals.end(),
                   [](const Proposal& a, const Proposal& b) { return a.logit > b.logit; });
  std::vector<Proposal> kept;
  for (const Proposal& proposal : proposals) {
    const auto overlaps = [&](const Proposal& other) { return iou(proposal.box, other.box) > max_iou; };
    if (std::none_of(kept.begin(), kept.end(), overlaps)) kept.push_back(proposal);
  }
  return kept;
}

}  // namespace mirage
