#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/error.h"
#include "detection/detector.h"

namespace mirage {

double Proposal::score() const {
  return logit >= 0 ? 1 / (1 + std::exp(-logit)) : std::exp(logit) / (1 + std::exp(logit));
}

namespace {

constexpr double kLongestSide = 1000, kFarthestBox = 1e5;  // m
constexpr double kLargestPicture = 1e6;                    // pixels

/// What is wrong with a proposal, and what its network should do; empty where nothing is.
std::pair<std::string, const char*> proposal_problem(const Proposal& proposal, Plane plane) {
  const auto& [box, logit, picture] = proposal;
  for (const double value : {box.x, box.y, box.length, box.width, box.yaw, picture.left, picture.top,
                             picture.right, picture.bottom, logit})
    if (!std::isfinite(value))
      return {"its box or logit is not finite", "check the detector's weights, and divisions by zero"};
  if (plane == Plane::picture) {
    if (picture.right < picture.left || picture.bottom < picture.top)
      return {fmt::format("left {:g} to right {:g} and top {:g} to bottom {:g} is no box", picture.left,
                          picture.right, picture.top, picture.bottom),
              "give left, top, right, bottom in pixels, not a centre and a size"};
    const double farthest = std::max(
        {std::abs(picture.left), std::abs(picture.top), std::abs(picture.right), std::abs(picture.bottom)});
    if (farthest > kLargestPicture)
      return {fmt::format("reaches to pixel {:g}", farthest), "limit what the network gives"};
    return {};
  }
  const double shorter = std::min(box.length, box.width), longer = std::max(box.length, box.width);
  if (shorter <= 0 || longer > kLongestSide)
    return {fmt::format("length {:g} m and width {:g} m are no size (over 0, at most {:g} m)", box.length,
                        box.width, kLongestSide),
            "let the network's sizes be positive, as by exp or softplus, and limit them"};
  if (std::hypot(box.x, box.y) > kFarthestBox)
    return {fmt::format("x {:g} m, y {:g} m is no place near the sensor", box.x, box.y),
            "give metres in the LiDAR's frame, and limit what the network gives"};
  return {};
}

}  // namespace

void check_proposals(std::span<const Proposal> proposals, Plane plane, const std::string& who) {
  for (std::size_t i = 0; i < proposals.size(); ++i)
    if (const auto [problem, fix] = proposal_problem(proposals[i], plane); !problem.empty())
      throw InputError(who, fmt::format("box {} of {}", i, proposals.size()), problem, fix);
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
  check_proposals(proposals, plane);  // a NaN has no place in an order
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
