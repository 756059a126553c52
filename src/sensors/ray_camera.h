// A ray-traced camera for generated frames: sun with shadows, sky light with occlusion, glossy paint, glass.
#pragma once

#include <cstdint>
#include <span>

#include "base/image.h"
#include "sensors/camera.h"
#include "sensors/lighting.h"
#include "sensors/material.h"
#include "sensors/ray_caster.h"

namespace mirage {

/// One mesh of a scene in `velo`. Meshes of one object share `object` (≥ 0); −1 is background.
struct Surface {
  Mesh mesh;
  Material material;
  int object = -1;
  bool smooth = false;      ///< shade with interpolated vertex normals (car bodies)
  TexelAtlas atlas{1, {}};  ///< if it has texels, they replace the material's albedo and pattern
};

/// The scene that rays meet: geometry and materials, index by index.
struct RayScene {
  /// Copies the surfaces' meshes, materials and objects.
  explicit RayScene(std::span<const Surface> surfaces);
  RayCaster caster;
  std::vector<Material> materials;
  std::vector<int> objects;
  /// Unit shading normal at a hit, on the side of the face's normal.
  Vec3f shading_normal(const Hit& hit) const;
  /// Albedo at a hit; p, n and footprint as in surface_albedo.
  Vec3f albedo(const Hit& hit, const Vec3f& p, const Vec3f& n, float footprint) const;
  /// Whether two hits of one mesh lie on one texel, or the mesh has none.
  bool same_texel(const Hit& a, const Hit& b) const;

 private:
  /// Index into the texels of the hit's mesh.
  std::size_t texel(const Hit& hit) const;
  struct Smooth {
    std::vector<Face> faces;
    std::vector<Vec3f> normals;  // one a vertex, area-weighted
  };
  std::vector<Smooth> smooth_;       // empty for flat meshes
  std::vector<TexelAtlas> atlases_;  // without texels for plain meshes
};

/// Sky radiance (scene-linear) by direction: a gradient from horizon to zenith, a glow around the sun.
struct Sky {
  Vec3f horizon = Vec3f(0.55f, 0.62f, 0.72f), zenith = Vec3f(0.18f, 0.30f, 0.55f);
  float glow = 0.6f;  ///< added radiance next to the sun
  float clouds = 0;   ///< share of the sky that is white
  std::uint32_t variant = 0;
  /// Ratio of the sky's radiance as the camera sees it to that which lights the scene: hazy skies behind
  /// trees and houses are overexposed in street pictures while the shadows stay dark.
  float seen = 1;
  /// Scene-linear radiance from a direction; both are unit vectors in `velo`.
  Vec3f radiance(const Vec3f& direction, const Vec3f& to_sun) const;
  /// Irradiance / π of open, level ground: the cosine-weighted mean of the radiance.
  Vec3f irradiance(const Vec3f& to_sun) const;
};

/// Light of a generated scene. `lighting.sun` is the sun's irradiance / π; the sky replaces hemisphere, and
/// `lighting.ambient` is light bounced by a point's surroundings.
struct SceneLight {
  Lighting lighting;
  Sky sky;
};

/// Samples of the ray-traced camera.
struct RayCameraSettings {
  int grid = 2;      ///< grid × grid primary rays a pixel
  int sky_rays = 2;  ///< rays that sample the sky's visibility, per shading point
  std::uint64_t seed = 0;
  /// With a grid of 2: two rays on the pixel's diagonal, and the other two only if these differ in mesh or
  /// normal.
  bool sparse = false;
};

/// The ray-traced picture, of the camera's size.
struct RayImage {
  ImageF color;       ///< scene-linear RGB
  ImageF depth;       ///< planar depth of the ray nearest to the pixel's centre, m; 0 without a hit
  Image<int> object;  ///< object id of the same ray, −1 background
  ImageF coverage;    ///< share of the pixel's rays that hit anything
};

/// Renders in parallel over rows. Depends on the arguments only, not on the thread count.
RayImage render(const RayScene& scene, const PinholeCamera& camera, const Transform& camera_from_velo,
                const SceneLight& light, const RayCameraSettings& settings = {});

}  // namespace mirage
