// The simple light model of the soft rasteriser, the exporter and the matched Cycles render.
#pragma once

#include <algorithm>

#include "base/types.h"

namespace mirage {

/// Radiance of a Lambert face with albedo ρ and unit normal n (scene-linear RGB, per channel):
///     ρ · (ambient + hemisphere · (1 + n·up)/2 + sun · max(0, n·l))
/// Irradiances include the factor 1/π: a white face perpendicular to `sun` alone has radiance `sun`.
struct Lighting {
  Vec3d to_sun_velo = Vec3d(0.4, 0.5, 0.77).normalized();  ///< unit vector towards the sun, `velo`
  Vec3d sun = Vec3d(0.55, 0.53, 0.48);
  Vec3d ambient = Vec3d(0.10, 0.10, 0.11);     ///< same from everywhere
  Vec3d hemisphere = Vec3d(0.20, 0.22, 0.26);  ///< times (1 + n·up) / 2: more from above
};

// Per-face Lambert shading multiplied into the texels, and its VJP.

/// Light factor of a face (RGB): ambient + hemisphere · (1 + n̂·up)/2 + sun · max(0, n̂·l), with n the
/// unnormalised face normal in `velo`. A face without area gets the ambient term only.
inline Vec3d shade(const Vec3d& normal_velo, const Lighting& light) {
  const double length = normal_velo.norm();
  Vec3d factor = light.ambient;
  if (!(length > 0)) return factor;
  const Vec3d n = normal_velo / length;
  factor += light.hemisphere * ((1 + n.z()) / 2);
  factor += light.sun * std::max(0.0, n.dot(light.to_sun_velo));
  return factor;
}

/// d loss / d normal, given d loss / d factor.
inline Vec3d shade_vjp(const Vec3d& normal_velo, const Lighting& light, const Vec3d& d_factor) {
  const double length = normal_velo.norm();
  if (!(length > 0)) return Vec3d::Zero();
  const Vec3d n = normal_velo / length, sun = light.to_sun_velo;
  Vec3d d_n = Vec3d(0, 0, d_factor.dot(light.hemisphere) / 2);
  if (n.dot(sun) > 0) d_n += d_factor.dot(light.sun) * sun;
  return (d_n - n * n.dot(d_n)) / length;
}

}  // namespace mirage
