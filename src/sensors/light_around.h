// What the rays of a light meet that miss the object (sensors/visible_light.h): sky, the roof under it, the
// vehicle's outline and the road.
#pragma once

#include "sensors/light_nodes.h"

namespace mirage {

class LightAround {
 public:
  static constexpr int kSky = -1, kDeck = -2, kRoad = -3;

  /// Sky alone where `around` is null. Rays start relative to `centre` (velo). Both must outlive this.
  LightAround(const Lighting& light, const LightSurroundings* around, const Vec3d& centre, RoofCells cells);

  /// One direction, and the radiance that comes against it.
  struct Along {
    Vec3f towards;
    Eigen::Vector4f sky;  ///< and a 0
    Vec3f deck, road;
    Vec3f roof_sky, roof_sun;  ///< of the roof's gloss: sky, and the sun where it shines

    /// Where a ray crosses the roof's plane, from its start; and the start's height over it.
    Eigen::Matrix<float, 2, 3> crossing;
    Vec2f crossing_offset, deck_shift;
    Vec3f height;
    float height_offset = 0;
    bool falls = false;  ///< towards the roof's plane from above
    bool goes_down = false;
  };
  Along along(const Vec3d& direction) const;

  /// What a ray that misses the object meets: a cell (>= 0), kSky, kDeck or kRoad.
  int meet(const Along& along, const Vec3f& start) const;

 private:
  Vec3d sky(const Vec3d& direction) const;
  /// What the gloss of a flat surface under the open sky sends back of sky and sun, met along a direction. It
  /// is as rough and glossy as the object's: so are the vehicle and the road in the path tracer.
  struct Sheen {
    Vec3d sky = Vec3d::Zero(), sun = Vec3d::Zero();
  };
  Sheen sheen(const Vec3d& normal, const Vec3d& direction) const;
  Vec3d level_radiance(const Vec3d& albedo, const Vec3d& direction) const;

  const Lighting& light_;
  const LightSurroundings* around_;
  RoofCells cells_;
  Transform roof_from_velo_ = Transform::Identity();
  Vec3d centre_in_roof_ = Vec3d::Zero();
  Eigen::AlignedBox2f roof_, deck_;
  Vec2f cells_per_metre_ = Vec2f::Zero();
};

}  // namespace mirage
