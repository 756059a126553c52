#include "geometry/box.h"

#include <algorithm>
#include <numbers>

namespace mirage {
namespace {

/// Two negative sides have a positive product but no area.
bool has_area(const BevBox& box) {
  return box.length > 0 && box.width > 0;
}

}  // namespace

std::array<Vec2d, 4> corners(const BevBox& box) {
  const Vec2d along(std::cos(box.yaw), std::sin(box.yaw)), left(-along.y(), along.x());
  const Vec2d centre(box.x, box.y), l = along * box.length / 2, w = left * box.width / 2;
  return {centre + l + w, centre - l + w, centre - l - w, centre + l - w};
}

std::array<Vec3d, 8> corners(const Box3& box) {
  std::array<Vec3d, 8> result;
  const auto flat = corners(box.bev);
  for (std::size_t i = 0; i < 4; ++i) {
    result[i] = Vec3d(flat[i].x(), flat[i].y(), box.bottom);
    result[i + 4] = Vec3d(flat[i].x(), flat[i].y(), box.bottom + box.height);
  }
  return result;
}

double intersection_area(const BevBox& a, const BevBox& b) {
  if (!has_area(a) || !has_area(b)) return 0;
  // Relative to a's centre: the corners of distant boxes would lose digits.
  const auto subject = corners(BevBox{0, 0, a.length, a.width, a.yaw}),
             clip = corners(BevBox{b.x - a.x, b.y - a.y, b.length, b.width, b.yaw});
  std::vector<Vec2d> polygon(subject.begin(), subject.end());
  for (std::size_t i = 0; i < 4 && !polygon.empty(); ++i) {
    const Vec2d from = clip[i], edge = clip[(i + 1) % 4] - clip[i];
    std::vector<Vec2d> kept;
    for (std::size_t k = 0; k < polygon.size(); ++k) {
      const Vec2d &p = polygon[k], &q = polygon[(k + 1) % polygon.size()];
      const double side_p = cross(edge, p - from), side_q = cross(edge, q - from);
      if (side_p >= 0) kept.push_back(p);
      if ((side_p > 0 && side_q < 0) || (side_p < 0 && side_q > 0))
        kept.push_back(p + (q - p) * (side_p / (side_p - side_q)));
    }
    polygon = std::move(kept);
  }
  double twice = 0;
  for (std::size_t k = 0; k < polygon.size(); ++k)
    twice += cross(polygon[k], polygon[(k + 1) % polygon.size()]);
  return std::max(0.0, twice / 2);
}

double iou(const BevBox& a, const BevBox& b) {
  if (!has_area(a) || !has_area(b)) return 0;
  const double area_a = a.length * a.width, area_b = b.length * b.width;
  const double reach = std::hypot(a.length, a.width) + std::hypot(b.length, b.width);
  if (2 * horizontal_distance(a, b) > reach) return 0;
  const double both = intersection_area(a, b);
  return std::clamp(both / (area_a + area_b - both), 0.0, 1.0);
}

double iou(const Box3& a, const Box3& b) {
  if (!has_area(a.bev) || !has_area(b.bev) || !(a.height > 0) || !(b.height > 0)) return 0;
  const double common = std::min(a.bottom + a.height, b.bottom + b.height) - std::max(a.bottom, b.bottom);
  if (!(common > 0)) return 0;
  const double both = intersection_area(a.bev, b.bev) * common;
  const auto volume = [](const Box3& box) { return box.bev.length * box.bev.width * box.height; };
  return std::clamp(both / (volume(a) + volume(b) - both), 0.0, 1.0);
}

std::pair<double, double> ray_within(const Vec3d& origin, const Vec3d& direction, const Vec3d& low,
                                     const Vec3d& high) {
  double enter = 0, leave = 1e9;
  for (int a = 0; a < 3; ++a) {
    if (std::abs(direction[a]) < 1e-12) {
      if (origin[a] < low[a] || origin[a] > high[a]) return {1, 0};
      continue;
    }
    const double t0 = (low[a] - origin[a]) / direction[a], t1 = (high[a] - origin[a]) / direction[a];
    enter = std::max(enter, std::min(t0, t1));
    leave = std::min(leave, std::max(t0, t1));
  }
  return {enter, leave};
}

Transform velo_from_box(const Box3& box) {
  Transform transform = Transform::Identity();
  transform.linear() = Eigen::AngleAxisd(box.bev.yaw, Vec3d::UnitZ()).toRotationMatrix();
  transform.translation() = Vec3d(box.bev.x, box.bev.y, box.bottom);
  return transform;
}

bool contains(const Box3& box, const Vec3d& p_velo, double margin) {
  const Vec3d p = velo_from_box(box).inverse() * p_velo;
  return std::abs(p.x()) <= box.bev.length / 2 + margin && std::abs(p.y()) <= box.bev.width / 2 + margin &&
         p.z() >= -margin && p.z() <= box.height + margin;
}

std::vector<Vec2d> convex_hull(std::vector<Vec2d> places) {
  std::sort(places.begin(), places.end(),
            [](const Vec2d& a, const Vec2d& b) { return std::pair(a.x(), a.y()) < std::pair(b.x(), b.y()); });
  std::vector<Vec2d> hull;
  for (int pass = 0; pass < 2 && !places.empty(); ++pass) {
    const std::size_t first = hull.size();
    for (const Vec2d& p : places) {
      while (hull.size() >= first + 2 && !(cross(hull.back() - hull[hull.size() - 2], p - hull.back()) > 0))
        hull.pop_back();
      hull.push_back(p);
    }
    hull.pop_back();  // the next pass starts with it
    std::reverse(places.begin(), places.end());
  }
  return hull;
}

double area(const PictureBox& box) {
  return std::max(0.0, box.right - box.left) * std::max(0.0, box.bottom - box.top);
}

double intersection_area(const PictureBox& a, const PictureBox& b) {
  return area({std::max(a.left, b.left), std::max(a.top, b.top), std::min(a.right, b.right),
               std::min(a.bottom, b.bottom)});
}

double iou(const PictureBox& a, const PictureBox& b) {
  const double both = intersection_area(a, b);
  return both > 0 ? std::clamp(both / (area(a) + area(b) - both), 0.0, 1.0) : 0;
}

BevBox rectangle(const PictureBox& box) {
  return {(box.left + box.right) / 2, (box.top + box.bottom) / 2, box.right - box.left, box.bottom - box.top,
          0};
}

PictureBox picture_box(const BevBox& rectangle) {
  const auto& [x, y, length, width, yaw] = rectangle;
  return {x - length / 2, y - width / 2, x + length / 2, y + width / 2};
}

PictureBox united(const PictureBox& a, const PictureBox& b) {
  return {std::min(a.left, b.left), std::min(a.top, b.top), std::max(a.right, b.right),
          std::max(a.bottom, b.bottom)};
}

PictureBox within(const PictureBox& box, int width, int height) {
  const double last_column = std::max(0, width - 1), last_row = std::max(0, height - 1);
  return {std::clamp(box.left, 0.0, last_column), std::clamp(box.top, 0.0, last_row),
          std::clamp(box.right, 0.0, last_column), std::clamp(box.bottom, 0.0, last_row)};
}

BevBox SeenRectangle::box() const {
  const Vec2d middle((along.low + along.high) / 2, (across.low + across.high) / 2);
  const double c = std::cos(yaw), s = std::sin(yaw);
  return {c * middle.x() - s * middle.y(), s * middle.x() + c * middle.y(), along.size(), across.size(), yaw};
}

SeenRectangle closest_rectangle(const std::vector<Vec2d>& places) {
  constexpr int kHeadings = 45;
  constexpr std::size_t kEnough = 400;
  constexpr double kMinDistance = 0.05;  // m
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
      closeness += 1 / std::max(nearest, kMinDistance);
    }
    if (closeness > most) most = closeness, best = tried;
  }
  return best;
}

std::optional<BevBox> car_seen_as(const SeenRectangle& seen) {
  constexpr double kLength = 3.9, kWidth = 1.65;                                       // m, KITTI's mean car
  constexpr double kMaxLength = 5.6, kMinLength = 1.2, kWidest = 2.0, kOneSide = 2.3;  // m
  const double longer = std::max(seen.along.size(), seen.across.size());
  if (longer > kMaxLength || longer < kMinLength || std::min(seen.along.size(), seen.across.size()) > kWidest)
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
