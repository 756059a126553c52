// What a surface is made of, for the ray-traced camera and for the LiDAR simulator.
#pragma once

#include <cstdint>

#include "base/types.h"

namespace mirage {

/// Procedural pattern that modulates the albedo, computed from the position in `velo` (m) and the normal.
enum class Pattern : std::uint8_t {
  plain,
  asphalt,
  grass,
  paving,
  facade,
  brick,
  foliage,
  bark,
  grille,
  cloth,
  stack
};

/// How a surface looks in camera and LiDAR.
struct Material {
  Vec3f albedo = Vec3f::Constant(0.5f);  ///< scene-linear
  Vec3f second = Vec3f::Constant(0.1f);  ///< the pattern's other colour: windows, joints
  Pattern pattern = Pattern::plain;
  std::uint32_t variant = 0;  ///< seeds the pattern
  float foot = -1.73f;        ///< facades: z of the ground before the wall (`velo`, m)
  float gloss = 0;            ///< mirror reflectance at normal incidence (Schlick); 0.04: clear coat, glass
  float transparency = 0;     ///< share of light that passes (glass); 0: opaque
  Vec3f emission = Vec3f::Zero();
  float lidar = 0.3f;  ///< diffuse reflectivity near 905 nm; above 1: retro-reflector
  /// The camera sees albedo and pattern alone, opaque and matt; the LiDAR meets gloss, transparency and an
  /// even `lidar` as without it. So a look-alike differs from the thing under it in pixels only, and a veiled
  /// surface of transparency 1 is there for the camera alone.
  bool veiled = false;
};

/// Share of the light that passes to the camera.
inline float seen_through(const Material& material) {
  return material.veiled ? 0.f : material.transparency;
}

/// Albedo at a point. `p` in `velo`, `n` unit; `footprint` is the pixel's size on the surface (m), beyond
/// which detail fades to its mean.
Vec3f surface_albedo(const Material& material, const Vec3f& p, const Vec3f& n, float footprint);

/// Mirror reflectance at normal incidence at a point: the material's, or the panes' of a facade.
float surface_gloss(const Material& material, const Vec3f& p, const Vec3f& n);

}  // namespace mirage
