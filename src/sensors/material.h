// Reflection of a rough dielectric beyond Lambert's share: the object's surface in the reports' path tracer
// (Blender's Principled BSDF, specular 0.5, roughness 0.5).
//
// With n the normal, v towards the camera, l towards the light, h = (l + v)/|l + v| and α = roughness²:
//     f_s = D(h) G(l, v) F(h·v) / (4 n·l n·v)    GGX and Smith's shadowing (Walter et al., EGSR 2007)
//     f_d = ρ/π · F_d(n, l, v)                   Burley's diffuse lobe (SIGGRAPH 2012 course notes, 5.3)
#pragma once

#include <cstdint>
#include <span>

#include "base/types.h"

namespace mirage {

/// Blender's roughness, whose square is α, and the refractive index of its specular 0.5.
inline constexpr double kRoughness = 0.5, kRefractiveIndex = 1.5;

/// F: reflected share of unpolarised light; `cosine` of the incidence in [0, 1].
double fresnel(double cosine);

/// π f_s max(0, n·l) from the cosines n·l, n·v and l·v. Times the irradiance over π on a face perpendicular
/// to l, it gives the radiance towards v. 0 if the light or the camera is behind the surface.
double specular_response(double nl, double nv, double lv);
/// The same for each entry of `responses`.
void specular_response(std::span<const float> nl, std::span<const float> nv, std::span<const float> lv,
                       std::span<float> responses);
/// The same for unit vectors.
double specular_response(const Vec3d& n, const Vec3d& l, const Vec3d& v);

/// Share of a uniform light that the lobe reflects towards a camera at that cosine: the integral of f_s n·l
/// over the half space. From a table, within 1 %.
double specular_albedo(double cosine);

/// F_d: 1 for Lambert's surface.
double diffuse_response(const Vec3d& n, const Vec3d& l, const Vec3d& v);

/// Mean of F_d under a uniform light, weighted by n·l, towards a camera at that cosine. From a table, within
/// 1 %.
double diffuse_albedo(double cosine);

// Surface materials for the ray-traced camera and for the LiDAR simulator.

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

/// Appearance of a surface in camera and LiDAR.
struct Material {
  Vec3f albedo = Vec3f::Constant(0.5f);  ///< scene-linear
  Vec3f second = Vec3f::Constant(0.1f);  ///< the pattern's other colour: windows, joints
  Pattern pattern = Pattern::plain;
  std::uint32_t variant = 0;  ///< seeds the pattern
  float foot = -1.73f;        ///< facades: z of the ground at the wall (`velo`, m)
  float gloss = 0;            ///< mirror reflectance at normal incidence (Schlick); 0.04: clear coat, glass
  float transparency = 0;     ///< share of light that passes (glass); 0: opaque
  Vec3f emission = Vec3f::Zero();
  float lidar = 0.3f;  ///< diffuse reflectivity near 905 nm; above 1: retro-reflector
  /// The camera sees only albedo and pattern, opaque and matt; the LiDAR still sees gloss, transparency and a
  /// uniform `lidar`. So a look-alike differs from the object under it in pixels only, and a veiled surface
  /// of transparency 1 exists for the camera only.
  bool veiled = false;
};

/// Share of the light that passes to the camera.
inline float seen_through(const Material& material) {
  return material.veiled ? 0.f : material.transparency;
}

/// Albedo at a point. `p` in `velo`, `n` unit; `footprint` is the pixel's size on the surface (m); finer
/// detail fades to its mean.
Vec3f surface_albedo(const Material& material, const Vec3f& p, const Vec3f& n, float footprint);

/// Mirror reflectance at normal incidence at a point: the material's, or the panes' of a facade.
float surface_gloss(const Material& material, const Vec3f& p, const Vec3f& n);

}  // namespace mirage
