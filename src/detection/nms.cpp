#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "detection/detector.h"

namespace mirage {

double Proposal::score() const {
  return logit >= 0 ? 1 / (1 + std::exp(-logit)) : std::exp(logit) / (1 + std::exp(logit));
}

void check_proposals(std::span<const Proposal> proposals) {
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const auto& [box, logit, picture] = proposals[i];
    for (double value : {box.x, box.y, box.length, box.width, box.yaw, picture.left, picture.top,
                         picture.right, picture.bottom, logit})
      if (!std::isfinite(value))
        throw InputError("detector", fmt::format("proposal {}", i), "its box or logit is not finite",
                         "check the detector's weights");
  }
}

std::string to_string(Plane plane) {
  return plane == Plane::bev ? "bev" : "picture";
}

BevBox rectangle(const Proposal& proposal, Plane plane) {
  return plane == Plane::bev ? proposal.box : rectangle(proposal.picture);
}

std::vector<Proposal> suppress(std::vector<Proposal> proposals, Plane plane) {
  return suppress(std::move(proposals), plane == Plane::bev ? 0.1 : 0.5, plane);
}

std::vector<Proposal> suppress(std::vector<Proposal> proposals, double max_iou, Plane plane) {
  check_proposals(proposals);  // a NaN has no place in an order
  std::stable_sort(proposals.begin(), proposals.end(),
                   [](const Proposal& a, const Proposal& b) { return a.logit > b.logit; });
  std::vector<Proposal> kept;
  for (const Proposal& proposal : proposals) {
    const BevBox box = rectangle(proposal, plane);
    const auto overlaps = [&](const Proposal& other) { return iou(box, rectangle(other, plane)) > max_iou; };
    if (std::none_of(kept.begin(), kept.end(), overlaps)) kept.push_back(proposal);
  }
  return kept;
}

}  // namespace mirage
