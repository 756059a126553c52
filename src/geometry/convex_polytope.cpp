#include "geometry/convex_polytope.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "base/sizes.h"

namespace mirage {
namespace {

/// Distances up to this are rounding errors.
constexpr double kRounding = 1e-12;
/// Largest distance of a point outside the hull.
constexpr double kLeftOut = 1e-10;
/// A thinner body has no volume.
constexpr double kThinnest = 1e-6;

/// The point of the triangle nearest to `p`.
Vec3d nearest_of_triangle(const Vec3d& p, const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  const Vec3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp),
               d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return a;
  if (d3 >= 0 && d4 <= d3) return b;
  if (d6 >= 0 && d5 <= d6) return c;
  const double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  if (va <= 0 && d4 >= d3 && d5 >= d6) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  const double all = va + vb + vc;
  return a + vb / all * ab + vc / all * ac;
}

/// Index of the point with the largest measure, and that value.
template <class Measure>
std::pair<int, double> farthest(std::span<const Vec3d> points, const Measure& measure) {
  std::pair<int, double> best{0, -std::numeric_limits<double>::infinity()};
  for (std::size_t i = 0; i < points.size(); ++i)
    if (const double far = measure(points[i]); far > best.second) best = {static_cast<int>(i), far};
  return best;
}

}  // namespace

std::optional<ConvexPolytope::Facet> ConvexPolytope::facet(std::span<const Vec3d> points,
                                                           const std::array<int, 3>& corners) {
  const auto at = [&](int k) -> const Vec3d& { return points[as_size(corners[as_size(k)])]; };
  const Vec3d across = (at(1) - at(0)).cross(at(2) - at(0));
  const double length = across.norm();
  if (!(length > 0)) return std::nullopt;
  const Vec3d normal = across / length;
  return Facet{corners, normal, std::max({normal.dot(at(0)), normal.dot(at(1)), normal.dot(at(2))})};
}

ConvexPolytope::ConvexPolytope(std::vector<Vec3d> corners, std::vector<Facet> facets)
    : corners_(std::move(corners)), facets_(std::move(facets)) {}

std::optional<ConvexPolytope> ConvexPolytope::hull(std::span<const Vec3d> points) {
  if (points.size() < 4 || !std::all_of(points.begin(), points.end(), [](const Vec3d& p) {
        return p.allFinite() && p.cwiseAbs().maxCoeff() < 1e6;
      }))
    return std::nullopt;
  const auto at = [&](int i) -> const Vec3d& { return points[as_size(i)]; };
  const int a = farthest(points, [](const Vec3d& p) { return -p.x(); }).first;
  const Vec3d& start = at(a);
  const auto [b, length] = farthest(points, [&](const Vec3d& p) { return (p - start).norm(); });
  if (!(length > kThinnest)) return std::nullopt;
  const Vec3d along = (at(b) - start) / length;
  const auto [c, width] = farthest(points, [&](const Vec3d& p) { return (p - start).cross(along).norm(); });
  if (!(width > kThinnest)) return std::nullopt;
  const Vec3d up = along.cross(at(c) - start).normalized();
  const auto [d, height] = farthest(points, [&](const Vec3d& p) { return std::abs(up.dot(p - start)); });
  if (!(height > kThinnest)) return std::nullopt;
  const bool above = up.dot(at(d) - start) > 0;
  const int second = above ? c : b, third = above ? b : c;  // so that the first facet faces away from d
  std::vector<Facet> facets;
  for (const std::array<int, 3>& corners :
       {std::array<int, 3>{a, second, third}, {a, d, second}, {second, d, third}, {third, d, a}}) {
    const auto made = facet(points, corners);
    if (!made) return std::nullopt;
    facets.push_back(*made);
  }
  // For each point, the facet that it is farthest beyond. A removed facet keeps its index.
  std::vector<bool> gone(facets.size(), false);
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> worst(points.size(), kNone);
  std::vector<double> far(points.size(), 0);
  const auto assign = [&](std::size_t i, std::size_t f) {
    if (gone[f]) return;
    if (const double out = facets[f].beyond(points[i]); out > far[i]) far[i] = out, worst[i] = f;
  };
  std::vector<bool> used(points.size(), false);
  for (const int i : {a, b, c, d}) used[as_size(i)] = true;
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t f = 0; f < facets.size(); ++f) assign(i, f);
  for (;;) {
    double best = kRounding;
    std::size_t next = kNone;
    for (std::size_t i = 0; i < points.size(); ++i)
      if (!used[i] && far[i] > best) best = far[i], next = i;
    if (next == kNone) break;
    used[next] = true;
    std::set<std::pair<int, int>> seen;  // directed edges of the facets that the point is beyond
    for (std::size_t f = 0; f < facets.size(); ++f) {
      if (gone[f] || !(facets[f].beyond(points[next]) > kRounding)) continue;
      gone[f] = true;
      for (std::size_t k = 0; k < 3; ++k) seen.emplace(facets[f].corners[k], facets[f].corners[(k + 1) % 3]);
    }
    const std::size_t before = facets.size();
    for (const auto& [from, to] : seen) {
      if (seen.contains({to, from})) continue;
      const auto made = facet(points, {from, to, static_cast<int>(next)});
      if (!made) return std::nullopt;
      facets.push_back(*made);
      gone.push_back(false);
    }
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (used[i] || worst[i] == kNone) continue;  // a point inside stays inside
      const bool anew = gone[worst[i]];
      if (anew) far[i] = 0, worst[i] = kNone;
      for (std::size_t f = anew ? 0 : before; f < facets.size(); ++f) assign(i, f);
    }
  }
  std::size_t whole = 0;
  for (std::size_t f = 0; f < facets.size(); ++f)
    if (!gone[f]) facets[whole++] = facets[f];
  facets.erase(facets.begin() + static_cast<std::ptrdiff_t>(whole), facets.end());
  for (const Vec3d& p : points)
    for (const Facet& f : facets)
      if (f.beyond(p) > kLeftOut) return std::nullopt;
  std::vector<int> place(points.size(), -1);
  for (const Facet& f : facets)
    for (const int i : f.corners) place[as_size(i)] = 0;
  std::vector<Vec3d> corners;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (place[i] == 0) {
      place[i] = static_cast<int>(corners.size());
      corners.push_back(points[i]);
    }
  for (Facet& f : facets)
    for (int& i : f.corners) i = place[as_size(i)];
  return ConvexPolytope(std::move(corners), std::move(facets));
}

std::optional<ConvexPolytope> ConvexPolytope::within(const Eigen::AlignedBox3d& box) const {
  std::optional<ConvexPolytope> rest = *this;
  for (int axis = 0; axis < 3 && rest; ++axis)
    for (const double sign : {-1.0, 1.0}) {
      if (!rest) break;
      const double side = sign < 0 ? box.min()[axis] : box.max()[axis];
      const auto beyond = [&](const Vec3d& p) { return sign * (p[axis] - side); };
      const std::vector<Vec3d>& corners = rest->corners_;
      if (std::all_of(corners.begin(), corners.end(), [&](const Vec3d& p) { return beyond(p) <= 0; }))
        continue;
      std::vector<Vec3d> points;
      for (const Vec3d& p : corners)
        if (beyond(p) <= 0) points.push_back(p);
      for (const Facet& f : rest->facets_)
        for (std::size_t k = 0; k < 3; ++k) {
          const int i = f.corners[k], j = f.corners[(k + 1) % 3];
          if (i > j) continue;  // the neighbour has it in reverse
          const Vec3d &p = corners[as_size(i)], &q = corners[as_size(j)];
          const double from = beyond(p), to = beyond(q);
          if (from <= 0 ? !(to > 0) : !(to < 0)) continue;
          Vec3d cut = p + from / (from - to) * (q - p);
          cut[axis] = side;
          points.push_back(cut);
        }
      rest = hull(points);
    }
  return rest;
}

double ConvexPolytope::outside(const Vec3d& point) const {
  double most = -std::numeric_limits<double>::infinity();
  for (const Facet& f : facets_) most = std::max(most, f.beyond(point));
  return most;
}

Vec3d ConvexPolytope::nearest(const Vec3d& point) const {
  Vec3d best = point;
  double least = std::numeric_limits<double>::infinity();
  for (const Facet& f : facets_) {
    if (!(f.beyond(point) > 0)) continue;
    const auto corner = [&](std::size_t k) -> const Vec3d& { return corners_[as_size(f.corners[k])]; };
    const Vec3d candidate = nearest_of_triangle(point, corner(0), corner(1), corner(2));
    if (const double far = (candidate - point).squaredNorm(); far < least) least = far, best = candidate;
  }
  return best;
}

}  // namespace mirage
