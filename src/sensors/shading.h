// Per-face Lambert shading (sensors/lighting.h) multiplied into the texels, and its VJP.
#pragma once

#include "sensors/lighting.h"

namespace mirage {

/// Light factor of a face (RGB): ambient + hemisphere · (1 + n̂·up)/2 + sun · max(0, n̂·l), with n the
/// unnormalised face normal in `velo`. A face without area gets the ambient term alone.
template <class S>
Vec3<S> shade(const Vec3<S>& normal_velo, const Lighting& light) {
  const S length = normal_velo.norm();
  Vec3<S> factor = light.ambient.cast<S>();
  if (!(length > 0)) return factor;
  const Vec3<S> n = normal_velo / length;
  factor += light.hemisphere.cast<S>() * ((1 + n.z()) / 2);
  factor += light.sun.cast<S>() * std::max(S(0), n.dot(light.to_sun_velo.cast<S>()));
  return factor;
}

/// d loss / d normal, given d loss / d factor.
template <class S>
Vec3<S> shade_vjp(const Vec3<S>& normal_velo, const Lighting& light, const Vec3<S>& d_factor) {
  const S length = normal_velo.norm();
  if (!(length > 0)) return Vec3<S>::Zero();
  const Vec3<S> n = normal_velo / length, sun = light.to_sun_velo.cast<S>();
  Vec3<S> d_n = Vec3<S>(0, 0, d_factor.dot(light.hemisphere.cast<S>()) / 2);
  if (n.dot(sun) > 0) d_n += d_factor.dot(light.sun.cast<S>()) * sun;
  return (d_n - n * n.dot(d_n)) / length;
}

}  // namespace mirage
