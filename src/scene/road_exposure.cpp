#include "scene/road_exposure.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/intervals.h"
#include "scene/light_surroundings.h"
#include "sensors/shading.h"

namespace mirage {
namespace {

constexpr double kNearest = 5, kFarthestRoad = 20, kAside = 1.5, kThickness = 0.15;  // m
constexpr std::size_t kFewestReturns = 50;                                           // returns
constexpr double kGroundQuantile = 0.2;  // quantile of the heights in the corridor: under cars and kerbs
// Darker is a road in the shade of trees beside sunlit cars, brighter one that mirrors a low sun between
// shaded ones.
constexpr double kDarkest = 0.5, kBrightest = 3;

}  // namespace

std::optional<Vec3d> road_radiance(const Frame& frame) {
  std::vector<Vec3d> corridor;
  for (const LidarPoint& point : frame.sweep) {
    const Vec3d p = point.position().cast<double>();
    if (!(p.x() >= kNearest && p.x() <= kFarthestRoad && std::abs(p.y()) <= kAside)) continue;
    const bool on_object = std::any_of(frame.labels.begin(), frame.labels.end(), [&](const Label& label) {
      return has_box(label) && contains(label.box, p, kThickness);
    });
    if (!on_object) corridor.push_back(p);
  }
  if (corridor.size() < kFewestReturns) return std::nullopt;
  std::vector<double> heights;
  for (const Vec3d& p : corridor) heights.push_back(p.z());
  const double ground = quantile(heights, kGroundQuantile);
  std::array<std::vector<double>, 3> colours;
  for (const Vec3d& p : corridor) {
    const Vec3d p_camera = frame.calibration.camera_from_velo * p;
    if (std::abs(p.z() - ground) > kThickness || p_camera.z() <= 0) continue;
    const Vec2d pixel = frame.calibration.camera.project(p_camera);
    const long u = std::lround(pixel.x()), v = std::lround(pixel.y());
    if (u < 0 || v < 0 || u >= frame.image.width || v >= frame.image.height) continue;
    for (int c = 0; c < 3; ++c)
      colours[static_cast<std::size_t>(c)].push_back(
          frame.image.at(static_cast<int>(u), static_cast<int>(v), c));
  }
  if (colours[0].size() < kFewestReturns) return std::nullopt;
  return Vec3d(quantile(colours[0], 0.5), quantile(colours[1], 0.5), quantile(colours[2], 0.5));
}

Lighting with_road_exposure(const Frame& frame) {
  Lighting lighting = frame.lighting;
  const std::optional<Vec3d> road = road_radiance(frame);
  if (!road) return lighting;
  const Vec3d level = kRoadAlbedo * shade<double>(Vec3d::UnitZ(), lighting);
  for (int c = 0; c < 3; ++c) {
    if (!(level[c] > 0)) continue;
    const double gain = std::clamp((*road)[c] / level[c], kDarkest, kBrightest);
    lighting.sun[c] *= gain;
    lighting.ambient[c] *= gain;
    lighting.hemisphere[c] *= gain;
  }
  return lighting;
}

}  // namespace mirage
