// The light model with visibility: the plain one (sensors/lighting.h) where nothing is in the way, less what
// the object itself, the roof under it and the road hide of sky and sun, plus what they reflect.
//
// With E the irradiance over π, ρ the albedo, n̂ the face's unit normal and ω_k, k < K, directions spread
// evenly over the sphere (Fibonacci lattice), each node i of the object's faces and the roof's cells has
//     E_i = ambient + hemisphere (1 + n̂·up)/2 + sun max(0, n̂·l) v_i
//         + Σ_k (4/K) max(0, n̂·ω_k) (L_hit − L_sky(ω_k))          over the directions that meet something
//     L_sky(ω) = ambient + hemisphere/2 + 3/4 hemisphere ω·up        whose irradiance is the first two terms
//     L_hit    = ρ_j E_j of the node that is met; the sunlit radiance of the road or of the host's body
// (radiosity by gathering; Goral et al., SIGGRAPH 1984, equation 5), iterated from E without reflections. A
// convex object in free space has the plain model's light exactly. Both sides of a face are nodes; a face is
// shown as the side that the camera sees is lit. The weights 4/K are scaled for each node so that
// Σ (4/K) max(0, n̂·ω_k) is 1. v_t, the share of the sun that a
// texel sees, is found for each texel, v_i is its mean over the face.
//
// What each ray meets is a value without a gradient: it jumps. For it held fixed everything else is exact,
// through the normals and through the albedos that reflect.
#pragma once

#include <array>
#include <vector>

#include "base/fields.h"
#include "geometry/mesh.h"
#include "sensors/lighting.h"

namespace mirage {

/// What an inserted object is lit by.
enum class LightModel {
  plain,    ///< sensors/shading.h: nothing shadows or reflects
  visible,  ///< this file
};
constexpr auto words_of(LightModel) {
  return std::to_array<const char*>({"plain", "visible"});
}

/// What stands around an object on a vehicle's roof: rectangles parallel to the roof, and a level road.
struct LightSurroundings {
  Transform velo_from_roof = Transform::Identity();  ///< origin on the roof, x along the heading, z up
  Eigen::AlignedBox2d roof{Vec2d(-0.8, -0.6), Vec2d(0.8, 0.6)};  ///< at z = 0, roof frame
  double deck_below = 0.6;                                       ///< m from the roof down to bonnet and boot
  Eigen::AlignedBox2d deck{Vec2d(-1.9, -0.8), Vec2d(2.1, 0.8)};  ///< the vehicle's outline at that height
  Vec3d paint = Vec3d::Constant(0.3);                            ///< albedo of the vehicle
  double road_below = 1.5;             ///< m from the roof's origin down to the road
  Vec3d road = Vec3d::Constant(0.18);  ///< albedo of the road
};

/// How finely visibility is sampled.
struct VisibleLightSettings {
  int directions = 32;  ///< K; a side sends rays along the half of them that it faces
  /// K of what is seen through reflections alone: the roof's cells and the sides that the camera does not
  /// see.
  int rough_directions = 16;
  int bounces = 2;      ///< gathering steps; 0: occlusion and the road's light alone
  int sun_samples = 4;  ///< n² rays to the sun from a face, each for the texels around it
  double cell = 0.4;    ///< m; the roof's cells, each with its own light
  /// Share of the light that a dielectric's surface sends back uncoloured (refractive index 1.5, rough), here
  /// evenly to all sides: a texel shows (albedo + gloss) · factor. Light within the object is reflected by
  /// the albedo alone.
  double gloss = 0.05;
};

/// What the rays met: values without a gradient.
struct LightVisibility {
  /// Another node that a node's rays met.
  struct Reflection {
    int node = 0;   ///< the one that is met
    Vec3d towards;  ///< ω times its weight
  };
  /// Nodes [0, faces) are the object's faces as they are wound, the next `faces` their backs; the roof's
  /// cells follow.
  std::size_t faces = 0;
  std::vector<bool> behind;              ///< of each face: the camera sees its back
  std::vector<Eigen::Matrix3d> blocked;  ///< of each node: Σ ω weight (L_fixed − L_sky)ᵀ, so that E += mᵀ n̂
  std::vector<int> first;                ///< nodes + 1: where each node's reflections start
  std::vector<Reflection> reflections;
  std::vector<float> sun;         ///< of each texel: share that sees the sun
  std::vector<double> sun_share;  ///< of each node
  Vec3d roof_normal = Vec3d::UnitZ(), paint = Vec3d::Zero();
  std::size_t rays = 0;

  /// Faces, their backs, and the roof's cells.
  std::size_t nodes() const { return sun_share.size(); }
  /// The node that the camera sees of a face.
  std::size_t side(std::size_t face) const { return behind[face] ? face + faces : face; }
};

/// Traces the rays. `surroundings` may be null: an object in free space. `eye` is the camera's place, which
/// tells the faces turned away from it; null: none is. The light's own values do matter:
/// the road's and the sky's radiances are in `blocked`.
LightVisibility find_visibility(const TexturedMesh& placed, const Lighting& light,
                                const LightSurroundings* surroundings, const Vec3d* eye = nullptr,
                                const VisibleLightSettings& settings = {});

/// Light factor of every texel, and what the VJP needs.
template <class S>
struct VisibleLight {
  std::vector<Vec3<S>> factor;                 ///< of each texel; never negative
  std::vector<std::vector<Vec3<S>>> received;  ///< E of every node before each gathering step
  std::vector<Vec3<S>> albedo;                 ///< of every node
  std::vector<Vec3<S>> sky;  ///< of every face: all light but the sun's own, before max(0, ·)
};
/// `normals`: unnormalised, of the faces, `velo`; `texels`: the atlas's albedos. A face without area has the
/// ambient term alone.
template <class S>
VisibleLight<S> visible_light(const std::vector<Vec3<S>>& normals, const std::vector<Vec3<S>>& texels,
                              const Lighting& light, const LightVisibility& visibility, int bounces);
/// Adds d loss / d normal and d loss / d texel, given d loss / d factor of every texel.
template <class S>
void visible_light_vjp(const std::vector<Vec3<S>>& normals, const std::vector<Vec3<S>>& texels,
                       const Lighting& light, const LightVisibility& visibility, const VisibleLight<S>& at,
                       const std::vector<Vec3<S>>& d_factor, std::vector<Vec3<S>>& d_normals,
                       std::vector<Vec3<S>>& d_texels);

}  // namespace mirage
