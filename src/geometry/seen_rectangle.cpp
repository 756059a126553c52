#include "geometry/seen_rectangle.h"

#include <numbers>
#include <utility>

namespace mirage {

BevBox SeenRectangle::box() const {
  const Vec2d middle((along.low + along.high) / 2, (across.low + across.high) / 2);
  const double c = std::cos(yaw), s = std::sin(yaw);
  return {c * middle.x() - s * middle.y(), s * middle.x() + c * middle.y(), along.size(), across.size(), yaw};
}

SeenRectangle closest_rectangle(const std::vector<Vec2d>& places) {
  constexpr int kHeadings = 45;
  constexpr std::size_t kEnough = 400;
  constexpr double kNearest = 0.05;  // m
  const std::size_t step = places.size() / kEnough + 1;
  SeenRectangle best;
  double most = -1;
  std::vector<Vec2d> turned(places.size());
  for (int k = 0; k < kHeadings; ++k) {
    const double yaw = k * std::numbers::pi / 2 / kHeadings, c = std::cos(yaw), s = std::sin(yaw);
    SeenRectangle tried{yaw, {1e9, -1e9}, {1e9, -1e9}};
    for (std::size_t i = 0; i < places.size(); ++i) {
      const Vec2d& p = places[i];
      const Vec2d q(c * p.x() + s * p.y(), c * p.y() - s * p.x());
      turned[i] = q;
      tried.along = {std::min(tried.along.low, q.x()), std::max(tried.along.high, q.x())};
      tried.across = {std::min(tried.across.low, q.y()), std::max(tried.across.high, q.y())};
    }
    double closeness = 0;
    for (std::size_t i = 0; i < places.size(); i += step) {
      const double nearest = std::min({turned[i].x() - tried.along.low, tried.along.high - turned[i].x(),
                                       turned[i].y() - tried.across.low, tried.across.high - turned[i].y()});
      closeness += 1 / std::max(nearest, kNearest);
    }
    if (closeness > most) most = closeness, best = tried;
  }
  return best;
}

std::optional<BevBox> car_seen_as(const SeenRectangle& seen) {
  constexpr double kLength = 3.9, kWidth = 1.65;                                    // m, KITTI's mean car
  constexpr double kLongest = 5.6, kShortest = 1.2, kWidest = 2.0, kOneSide = 2.3;  // m
  const double longer = std::max(seen.along.size(), seen.across.size());
  if (longer > kLongest || longer < kShortest || std::min(seen.along.size(), seen.across.size()) > kWidest)
    return std::nullopt;
  bool heads_along = seen.along.size() >= seen.across.size();
  if (longer < kOneSide)  // a front or a rear: its length lies along the line of sight
    heads_along = std::abs(seen.along.low + seen.along.high) > std::abs(seen.across.low + seen.across.high);
  const SeenSide along = seen.along.grown(heads_along ? kLength : kWidth),
                 across = seen.across.grown(heads_along ? kWidth : kLength);
  BevBox box = SeenRectangle{seen.yaw, along, across}.box();
  if (!heads_along) {
    std::swap(box.length, box.width);
    box.yaw += std::numbers::pi / 2;
  }
  return box;
}

}  // namespace mirage
