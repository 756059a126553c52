#include "scene/shape/vehicle_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>

namespace mirage {
namespace {

constexpr double kGroundBand = 0.4;    // m over and under the box's bottom in which ground is looked for
constexpr double kGroundScale = 0.05;  // m, of the robust weights
constexpr double kMaxSlope = 0.12;     // against the box's own level
constexpr int kEvidenceRounds = 8;

/// Plane by iteratively reweighted least squares with Cauchy weights, started from the box's bottom; slopes
/// are held back (0.05) so that ground seen on one side only doesn't tilt it.
std::optional<GroundPlane> fit_ground(const std::vector<Vec3d>& points, const EvidenceSettings& settings) {
  if (static_cast<int>(points.size()) < settings.min_ground) return std::nullopt;
  // Start from the lower quartile: what stands on the ground is above it.
  std::vector<double> heights;
  for (const Vec3d& p : points) heights.push_back(p.z());
  std::nth_element(heights.begin(), heights.begin() + static_cast<long>(heights.size() / 4), heights.end());
  GroundPlane plane{heights[heights.size() / 4], Vec2d::Zero()};
  double support = 0;
  for (int round = 0; round < kEvidenceRounds; ++round) {
    Eigen::Matrix3d normal = Eigen::Vector3d(1e-9, 1, 1).asDiagonal();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    normal *= static_cast<double>(points.size()) * 0.05 * 0.05;
    support = 0;
    for (const Vec3d& p : points) {
      const double r = (p.z() - plane.at(p.x(), p.y())) / kGroundScale, w = 1 / (1 + r * r);
      const Vec3d row(1, p.x(), p.y());
      normal += w * row * row.transpose();
      right += w * p.z() * row;
      support += r * r < 4;
    }
    const Eigen::Vector3d solution = normal.ldlt().solve(right);
    plane = {solution[0], solution.tail<2>()};
  }
  if (support < settings.min_ground || plane.slope.norm() > kMaxSlope || !std::isfinite(plane.height) ||
      std::abs(plane.height) > kGroundBand)
    return std::nullopt;
  return plane;
}

/// Part of a ray inside a box around the origin, as ray parameters; empty where low > high.
std::pair<double, double> clip(const Vec3d& origin, const Vec3d& direction, const Vec3d& low,
                               const Vec3d& high) {
  double from = 0, to = 1e9;
  for (int a = 0; a < 3; ++a) {
    if (std::abs(direction[a]) < 1e-12) {
      if (origin[a] < low[a] || origin[a] > high[a]) return {1, 0};
      continue;
    }
    const double t0 = (low[a] - origin[a]) / direction[a], t1 = (high[a] - origin[a]) / direction[a];
    from = std::max(from, std::min(t0, t1));
    to = std::min(to, std::max(t0, t1));
  }
  return {from, to};
}

}  // namespace

VehicleEvidence gather_evidence(const SweepIndex& sweep, const Box3& box, const EvidenceSettings& settings) {
  const Transform velo_from_frame = velo_from_box(box), frame_from_velo = velo_from_frame.inverse();
  const Vec3d half(0.5 * box.bev.length, 0.5 * box.bev.width, 0.5 * box.height);
  const double reach = half.norm() + settings.grow + settings.ground_ring;
  const auto rays = sweep.rays_through(velo_from_frame * Vec3d(0, 0, half.z()), reach);

  VehicleEvidence evidence;
  std::vector<Vec3d> returns, around;
  std::vector<Vec2d> returns_seen;
  struct Candidate {
    Segment segment;
    Vec2d seen;  // where its ray crosses the upright plane through the box's middle, across the view
  };
  std::vector<Candidate> candidates;
  const Vec3d grow = Vec3d::Constant(settings.grow);
  const Vec3d low = Vec3d(-half.x(), -half.y(), 0) - grow,
              high = Vec3d(half.x(), half.y(), box.height) + grow;
  if (rays.empty()) return evidence;
  Vec3d eye = Vec3d::Zero();
  for (const SweepRay& ray : rays) eye += frame_from_velo * ray.ray.origin / static_cast<double>(rays.size());
  const Vec2d ahead = -eye.head<2>().normalized(), left(-ahead.y(), ahead.x());
  const auto seen = [&](const Vec3d& origin, const Vec3d& direction) {
    const double along = ahead.dot(direction.head<2>());
    const Vec3d p = origin - ahead.dot(origin.head<2>()) / (along > 1e-6 ? along : 1e-6) * direction;
    return Vec2d(left.dot(p.head<2>()), p.z());
  };
  for (const SweepRay& ray : rays) {
    if (ray.point < 0) continue;
    const Vec3d origin = frame_from_velo * ray.ray.origin,
                direction = frame_from_velo.linear() * ray.ray.direction;
    const Vec3d p = origin + ray.range * direction;
    const bool within = std::abs(p.x()) < high.x() && std::abs(p.y()) < high.y();
    if (within && p.z() < high.z()) {
      returns.push_back(p);
      returns_seen.push_back(seen(origin, direction));
    }
    const bool ring = std::abs(p.x()) < high.x() + settings.ground_ring &&
                      std::abs(p.y()) < high.y() + settings.ground_ring;
    if (ring && std::abs(p.z()) < kGroundBand && !(within && p.z() > settings.above_ground))
      around.push_back(p);
    auto [from, to] = clip(origin, direction, low, high);
    to = std::min(to, ray.range - settings.before);
    if (from < to)
      candidates.push_back({{origin + from * direction, origin + to * direction}, seen(origin, direction)});
  }
  evidence.ground = fit_ground(around, settings);
  const GroundPlane ground = evidence.ground.value_or(GroundPlane{});

  // The highest return on the vehicle in each upright strip of the view.
  constexpr double kStrip = 0.1;  // m
  const auto strip_of = [&](double across) { return static_cast<int>(std::floor(across / kStrip)); };
  std::map<int, double> highest;
  std::set<std::array<int, 3>> taken;
  for (std::size_t i = 0; i < returns.size(); ++i) {
    const Vec3d& p = returns[i];
    if (p.z() - ground.at(p.x(), p.y()) < settings.above_ground) continue;
    ++evidence.points;
    double& top = highest.try_emplace(strip_of(returns_seen[i].x()), -1e9).first->second;
    top = std::max(top, returns_seen[i].y());
    std::array<int, 3> cell;
    for (int a = 0; a < 3; ++a) cell[a] = static_cast<int>(std::floor(p[a] / settings.cell));
    if (taken.insert(cell).second) evidence.surface.push_back(p);
  }
  std::erase_if(candidates, [&](const Candidate& c) {
    const auto end = highest.upper_bound(strip_of(c.seen.x() + settings.beside));
    for (auto it = highest.lower_bound(strip_of(c.seen.x() - settings.beside)); it != end; ++it)
      if (it->second > c.seen.y()) return true;
    return false;
  });
  const auto count = candidates.size(), keep = std::min(count, static_cast<std::size_t>(settings.max_rays));
  for (std::size_t i = 0; i < keep; ++i) evidence.empty.push_back(candidates[i * count / keep].segment);
  return evidence;
}

}  // namespace mirage
