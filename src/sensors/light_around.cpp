#include "sensors/light_around.h"

#include <algorithm>

#include "sensors/gloss.h"

namespace mirage {

LightAround::LightAround(const Lighting& light, const LightSurroundings* around, const Vec3d& centre,
                         RoofCells cells)
    : light_(light), around_(around), cells_(cells) {
  if (!around) return;
  roof_from_velo_ = around->velo_from_roof.inverse();
  centre_in_roof_ = roof_from_velo_ * centre;
  roof_ = around->roof.cast<float>(), deck_ = around->deck.cast<float>();
  cells_per_metre_ = Vec2f(static_cast<float>(cells.columns), static_cast<float>(cells.rows))
                         .cwiseQuotient(roof_.sizes().cwiseMax(1e-3f));
}

Vec3d LightAround::sky(const Vec3d& direction) const {
  return light_.ambient + light_.hemisphere / 2 + 0.75 * direction.z() * light_.hemisphere;
}

LightAround::Sheen LightAround::sheen(const Vec3d& normal, const Vec3d& direction) const {
  const Vec3d v = -direction;
  return {specular_albedo(normal.dot(v)) * sky(direction + 2 * normal.dot(v) * normal),
          specular_response(normal, light_.to_sun_velo, v) * light_.sun};
}

/// Radiance of a level surface under the open sky, met along a direction that goes down.
Vec3d LightAround::level_radiance(const Vec3d& albedo, const Vec3d& direction) const {
  const Vec3d n = Vec3d::UnitZ(), &l = light_.to_sun_velo;
  const Vec3d lit = light_.ambient + light_.hemisphere +
                    std::max(0.0, l.z()) * diffuse_response(n, l, -direction) * light_.sun;
  const Sheen gloss = sheen(n, direction);
  return albedo.cwiseProduct(lit) + gloss.sky + gloss.sun;
}

LightAround::Along LightAround::along(const Vec3d& direction) const {
  Along along;
  along.towards = direction.cast<float>();
  along.goes_down = direction.z() < 0;
  along.sky << sky(direction).cast<float>(), 0;
  along.deck = along.road = along.roof_sky = along.roof_sun = Vec3f::Zero();
  if (!around_) return along;
  if (direction.z() < 0) {
    along.deck = level_radiance(around_->paint, direction).cast<float>();
    along.road = level_radiance(around_->road, direction).cast<float>();
  }
  const Eigen::Matrix3d turn = roof_from_velo_.linear();
  const Vec3d d = turn * direction;
  if (!(d.z() < 0)) return along;
  along.falls = true;
  const Sheen roof = sheen(around_->velo_from_roof.linear().col(2), direction);
  along.roof_sky = roof.sky.cast<float>(), along.roof_sun = roof.sun.cast<float>();
  const Vec2d slope = d.head<2>() / d.z();
  along.crossing = (turn.topRows<2>() - slope * turn.row(2)).cast<float>();
  along.crossing_offset = (centre_in_roof_.head<2>() - centre_in_roof_.z() * slope).cast<float>();
  along.deck_shift = (-around_->deck_below * slope).cast<float>();
  along.height = turn.row(2).transpose().cast<float>();
  along.height_offset = static_cast<float>(centre_in_roof_.z());
  return along;
}

int LightAround::meet(const Along& along, const Vec3f& start) const {
  if (!around_) return kSky;
  if (along.falls) {
    const Vec2f at = along.crossing * start + along.crossing_offset;
    if (along.height.dot(start) + along.height_offset > 0 && roof_.contains(at)) {
      const Vec2f cell = (at - roof_.min()).cwiseProduct(cells_per_metre_);
      return std::clamp(static_cast<int>(cell.y()), 0, cells_.rows - 1) * cells_.columns +
             std::clamp(static_cast<int>(cell.x()), 0, cells_.columns - 1);
    }
    if (deck_.contains(Vec2f(at + along.deck_shift))) return kDeck;
  }
  return along.goes_down ? kRoad : kSky;
}

}  // namespace mirage
