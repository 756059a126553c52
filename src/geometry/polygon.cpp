#include "geometry/polygon.h"

#include <cstddef>

namespace mirage {
namespace {

/// Twice the area vector.
Vec3d area_vector(std::span<const Vec3d> corners) {
  Vec3d sum = Vec3d::Zero();
  for (std::size_t i = 0; i < corners.size(); ++i)
    sum += (corners[i] - corners[0]).cross(corners[(i + 1) % corners.size()] - corners[0]);
  return sum;
}

double turn(const Vec2d& a, const Vec2d& b, const Vec2d& c) {
  const Vec2d u = b - a, v = c - a;
  return u.x() * v.y() - u.y() * v.x();
}

/// A ring of corners in the plane, counter-clockwise, of which ears are taken.
class Ring {
 public:
  explicit Ring(std::vector<Vec2d> places) : places_(std::move(places)) {
    const int n = static_cast<int>(places_.size());
    for (int i = 0; i < n; ++i) {
      before_.push_back((i + n - 1) % n);
      after_.push_back((i + 1) % n);
    }
  }
  int before(int i) const { return before_[static_cast<std::size_t>(i)]; }
  int after(int i) const { return after_[static_cast<std::size_t>(i)]; }
  void take(int i) {
    after_[static_cast<std::size_t>(before(i))] = after(i);
    before_[static_cast<std::size_t>(after(i))] = before(i);
  }
  /// Whether the corner turns left and no other lies within the triangle with its neighbours.
  bool is_ear(int i) const {
    const int previous = before(i), next = after(i);
    const Vec2d &a = at(previous), &b = at(i), &c = at(next);
    if (!(turn(a, b, c) > 0)) return false;
    for (int k = after(next); k != previous; k = after(k)) {
      const Vec2d& p = at(k);
      // Those that turn left can't be the only ones within.
      if (turn(at(before(k)), p, at(after(k))) > 0 || p == a || p == b || p == c) continue;
      if (turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0) return false;
    }
    return true;
  }

 private:
  const Vec2d& at(int i) const { return places_[static_cast<std::size_t>(i)]; }

  std::vector<Vec2d> places_;
  std::vector<int> before_, after_;
};

}  // namespace

std::vector<std::array<int, 3>> cut_polygon(std::span<const Vec3d> corners) {
  const int n = static_cast<int>(corners.size());
  if (n < 3) return {};
  if (n == 3) return {{0, 1, 2}};
  // Seen along the axis that shows most of it, from the side where it runs counter-clockwise.
  const Vec3d area = area_vector(corners);
  Eigen::Index along = 0;
  area.cwiseAbs().maxCoeff(&along);
  Eigen::Index right = (along + 1) % 3, up = (along + 2) % 3;
  if (area[along] < 0) std::swap(right, up);
  std::vector<Vec2d> places;
  for (const Vec3d& corner : corners) places.emplace_back(corner[right], corner[up]);
  Ring ring(std::move(places));
  std::vector<std::array<int, 3>> triangles;
  int at = 0, passed = 0;
  for (int left = n; left > 3;) {
    // Once all have been looked at there is none: any will do.
    if (passed < left && !ring.is_ear(at)) {
      at = ring.after(at);
      ++passed;
      continue;
    }
    const int next = ring.after(at);
    triangles.push_back({ring.before(at), at, next});
    ring.take(at);
    --left;
    passed = 0;
    at = ring.after(next);  // not the next, which would make a fan of slivers
  }
  triangles.push_back({ring.before(at), at, ring.after(at)});
  return triangles;
}

}  // namespace mirage
