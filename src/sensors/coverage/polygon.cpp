#include "sensors/coverage/polygon.h"

#include <algorithm>

namespace mirage::coverage {
namespace {

/// Appends the part of the polygon where sign · distance ≥ 0.
Polygon part(Pool& pool, const Polygon& polygon, double sign, double slack, const Side& cut) {
  Polygon result{static_cast<int>(pool.corners.size()), 0};
  const auto place = [&](int i) {
    const double d = sign * pool.distances[static_cast<std::size_t>(i)];
    return d > slack ? 1 : d < -slack ? -1 : 0;
  };
  for (int i = 0; i < polygon.count; ++i) {
    const int next = i + 1 < polygon.count ? i + 1 : 0, here = place(i), there = place(next);
    const Corner corner = pool.corner(polygon, i);
    if (here >= 0) pool.corners.push_back({corner.p, here == 0 && there < 0 ? cut : corner.side});
    if (here * there >= 0) continue;
    const double a = pool.distances[static_cast<std::size_t>(i)],
                 b = pool.distances[static_cast<std::size_t>(next)];
    // From the end with the lower distance, so that both parts get the same point.
    const Vec2d to = pool.corner(polygon, next).p;
    const Vec2d p =
        a < b ? Vec2d(corner.p + a / (a - b) * (to - corner.p)) : Vec2d(to + b / (b - a) * (corner.p - to));
    pool.corners.push_back({p, here > 0 ? cut : corner.side});
  }
  result.count = static_cast<int>(pool.corners.size()) - result.first;
  return result;
}

}  // namespace

Polygon Pool::copy(const Pool& from, const Polygon& polygon) {
  const Polygon result{static_cast<int>(corners.size()), polygon.count};
  const auto first = from.corners.begin() + polygon.first;
  corners.insert(corners.end(), first, first + polygon.count);
  return result;
}

double Pool::area(const Polygon& polygon) const {
  double twice = 0;
  if (polygon.empty()) return 0;
  const Vec2d origin = corner(polygon, 0).p;
  for (int i = 1; i + 1 < polygon.count; ++i) {
    const Vec2d a = corner(polygon, i).p - origin, b = corner(polygon, i + 1).p - origin;
    twice += a.x() * b.y() - a.y() * b.x();
  }
  return twice / 2;
}

void split(Pool& pool, Polygon polygon, const Line& line, const Side& cut, Polygon& front, Polygon& back) {
  pool.distances.resize(std::max(pool.distances.size(), static_cast<std::size_t>(polygon.count)));
  double low = 0, high = 0;
  for (int i = 0; i < polygon.count; ++i) {
    const double d = line.at(pool.corner(polygon, i).p);
    pool.distances[static_cast<std::size_t>(i)] = d;
    low = std::min(low, d);
    high = std::max(high, d);
  }
  front = back = {};
  if (high <= line.slack) {
    back = polygon;
  } else if (low >= -line.slack) {
    front = polygon;
  } else {
    front = part(pool, polygon, 1, line.slack, cut);
    back = part(pool, polygon, -1, line.slack, cut);
  }
}

}  // namespace mirage::coverage
