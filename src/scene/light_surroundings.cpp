#include "scene/light_surroundings.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace mirage {
namespace {

constexpr double kRoofDrop = 0.15;  // m; vertices of a fitted vehicle no further below its roof belong to it
constexpr int kPaintSamples = 32;   // pixels along each side of the window that the median is taken over

}  // namespace

Vec3d vehicle_paint(const Frame& frame, const Label& host) {
  const int u0 = std::max(0, static_cast<int>(host.left)),
            u1 = std::min(frame.image.width, static_cast<int>(host.right));
  const int v0 = std::max(0, static_cast<int>(host.top + 0.4 * (host.bottom - host.top)));
  const int v1 = std::min(frame.image.height, static_cast<int>(host.top + 0.8 * (host.bottom - host.top)));
  Vec3d albedo = Vec3d::Constant(0.3);
  if (u1 <= u0 || v1 <= v0) return albedo;
  const Lighting& light = frame.lighting;
  const int step_u = 1 + (u1 - u0 - 1) / kPaintSamples, step_v = 1 + (v1 - v0 - 1) / kPaintSamples;
  for (int c = 0; c < 3; ++c) {
    std::vector<float> values;
    for (int v = v0; v < v1; v += step_v)
      for (int u = u0; u < u1; u += step_u) values.push_back(frame.image.at(u, v, c));
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    const double received = light.ambient[c] + light.hemisphere[c] / 2 + light.sun[c] / 3;
    albedo[c] = std::clamp(*middle / std::max(received, 1e-3), 0.02, 0.85);
  }
  return albedo;
}

LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier) {
  const Label& host = carrier.label;
  LightSurroundings around;
  around.velo_from_roof = carrier.velo_from_roof;
  around.paint = vehicle_paint(frame, host);
  around.road = Vec3d::Constant(kRoadAlbedo);
  const Transform roof_from_velo = carrier.velo_from_roof.inverse();
  const double l = host.box.bev.length, w = host.box.bev.width, h = host.box.height;
  around.deck_below = (1 - saloon::kWaist) * h;
  if (carrier.shape && !carrier.shape->faces.empty()) {
    around.roof.setEmpty();
    around.deck.setEmpty();
    double lowest = 0;
    for (const std::size_t i : used_vertices(*carrier.shape)) {
      const Vec3d p = roof_from_velo * carrier.shape->vertices[i];
      around.deck.extend(Vec2d(p.head<2>()));
      if (p.z() > -kRoofDrop) around.roof.extend(Vec2d(p.head<2>()));
      lowest = std::min(lowest, p.z());
    }
    around.road_below = -lowest;
    if (!around.roof.isEmpty()) return around;
  }
  const Vec3d centre = roof_from_velo * Vec3d(host.box.bev.x, host.box.bev.y, host.box.bottom);
  around.road_below = -centre.z();
  const Vec2d middle = centre.head<2>();
  around.deck = {middle - Vec2d(l, w) / 2, middle + Vec2d(l, w) / 2};
  around.roof = {middle + Vec2d(saloon::kRoofRear * l, -saloon::kRoofWidth * w / 2),
                 middle + Vec2d(saloon::kRoofFront * l, saloon::kRoofWidth * w / 2)};
  return around;
}

}  // namespace mirage
