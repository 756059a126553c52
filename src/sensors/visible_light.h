// The light model with visibility: the plain one (sensors/lighting.h), less the sky and sun hidden by the
// object itself, the roof under it and the road, plus the light that they reflect.
//
// With E the irradiance over π, ρ the albedo, n̂ the unit normal and ω_k, k < K, directions spread evenly over
// the sphere (Fibonacci lattice), each node i (a side of a face, or one of the parts of a side that the
// camera sees large; a cell of the roof; sensors/light_nodes.h) has
//     E_i = ambient + hemisphere (1 + n̂·up)/2 + sun max(0, n̂·l) v_i
//         + Σ_k (4/K) max(0, n̂·ω_k) (L_hit − L_sky(ω_k))          over the directions with a hit
//     L_sky(ω) = ambient + hemisphere/2 + 3/4 hemisphere ω·up        whose irradiance is the first two terms
//     L_hit    = ρ_j E_j + a_ij (E_j − sun's part) + π f_s(l) max(0, n̂_j·l) sun v_j     a node of the object
//                ρ_j E_j, and the gloss of an open sky and of the sun v_j                  a cell of the roof
//                the plain model's radiance                                a vehicle beside the object
//                the radiance of road or vehicle under the open sky, colour and gloss      what is left
// with a_ij and f_s of the gloss of the surface hit, along the ray
// (radiosity by gathering; Goral et al., SIGGRAPH 1984, equation 5), iterated from E without reflections. A
// convex object in free space has the plain model's light exactly. A face is drawn with the light of the side
// that the camera sees: a texel t of albedo ρ_t at node i has the radiance
//     ρ_t (m_i (E_i − sun's part) + sun max(0, n̂·l) F_d(l) v_t)                     Burley's diffuse lobe
//     + a_i Σ_k f_k L_k / Σ_k f_k + π f_s(l) max(0, n̂·l) sun v_t                    the surface's gloss
// with f_k the gloss's response to the light from ω_k (sensors/material.h), L_k the radiance from there (the
// sky's without a hit), a_i the share of a uniform light that the lobe sends to the camera, and m_i the mean
// of F_d over the directions. Without a camera there is no gloss and F_d is 1. The weights 4/K are scaled for
// each node so that Σ (4/K) max(0, n̂·ω_k) is 1. v_t, the share of the sun that a texel sees, is found for
// each texel and, at shadow borders close to the camera, for parts of it (light_visibility.cpp); v_i is the
// node's.
//
// The hit of each ray has no gradient: it jumps. Nor have the shares that depend on the camera's position or
// on a ray's course: a_i, a_ij, f_k, m_i, F_d and f_s. With these held fixed the gradient is exact, through
// the normals and through the reflecting albedos.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "base/fields.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/lighting.h"

namespace mirage {

/// The light on an inserted object.
enum class LightModel {
  plain,    ///< sensors/lighting.h: nothing shadows or reflects
  visible,  ///< this file
  fine,     ///< this file, sampled finely (fine_light)
};
constexpr auto words_of(LightModel) {
  return std::to_array<const char*>({"plain", "visible", "fine"});
}

/// Surroundings of an object on a vehicle's roof: rectangles parallel to the roof, and a level road.
struct LightSurroundings {
  Transform velo_from_roof = Transform::Identity();  ///< origin on the roof, x along the heading, z up
  Eigen::AlignedBox2d roof{Vec2d(-0.8, -0.6), Vec2d(0.8, 0.6)};  ///< at z = 0, roof frame
  double deck_below = 0.6;                                       ///< m from the roof down to bonnet and boot
  Eigen::AlignedBox2d deck{Vec2d(-1.9, -0.8), Vec2d(2.1, 0.8)};  ///< the vehicle's outline at that height
  Vec3d paint = Vec3d::Constant(0.3);                            ///< albedo of the vehicle
  double road_below = 1.5;             ///< m from the roof's origin down to the road
  Vec3d road = Vec3d::Constant(0.18);  ///< albedo of the road
  /// A vehicle of that paint beside the object (`velo`, m): it hides sun and sky, and has the plain model's
  /// light. Null: no such vehicle.
  std::shared_ptr<const Mesh> beside = {};
};

/// Sampling of visibility.
struct VisibleLightSettings {
  int directions = 40;  ///< K; a side sends rays along the half that it faces
  /// K of nodes visible only in reflections: the roof's cells and the sides that the camera does not see.
  int rough_directions = 8;
  int bounces = 4;      ///< gathering steps; 0: occlusion and the road's light only
  int sun_samples = 5;  ///< n² rays to the sun from a face, each for the texels around it
  /// sr; where a shadow's border crosses faces whose texels the camera sees under a larger angle, texels are
  /// split into parts below it, each with its own ray to the sun.
  double sun_angle = 1e-6;
  double cell = 0.4;  ///< m; the roof's cells, each with its own light
  /// sr; a side that the camera sees under a larger angle is split into n² parts below it, n at most the
  /// atlas's C. KITTI's pixel is 1.9e-6.
  double node_angle = 1.5e-4;
  double enclosed_node_angle = 6e-6;  ///< sr; the same for enclosed sides, if smaller
  /// A side is enclosed if the object rises above its plane by more than this: sine of the highest corner's
  /// elevation, seen from the side's middle.
  double open_below = 0.8;
  /// Whether the object's surface is a rough dielectric (sensors/material.h); otherwise Lambertian.
  bool glossy = true;
};
template <class Visitor, FieldsOf<VisibleLightSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "directions", .range = {1, 65536}, .option = ""}, s.directions);
  visit({.name = "rough_directions", .range = {1, 65536}, .option = ""}, s.rough_directions);
  visit({.name = "bounces", .range = {0, 64}, .option = ""}, s.bounces);
  visit({.name = "sun_samples", .range = {1, 64}, .option = ""}, s.sun_samples);
  visit({.name = "sun_angle", .range = kNotNegative, .option = ""}, s.sun_angle);
  visit({.name = "cell", .range = {0.01, 100}, .option = ""}, s.cell);
  visit({.name = "node_angle", .range = kNotNegative, .option = ""}, s.node_angle);
  visit({.name = "enclosed_node_angle", .range = kNotNegative, .option = ""}, s.enclosed_node_angle);
  visit({.name = "open_below", .range = {-1, 1}, .option = ""}, s.open_below);
  visit({.name = "glossy", .option = ""}, s.glossy);
}

/// More directions, finer nodes and much finer shadows; an insertion takes a third longer.
VisibleLightSettings fine_light();

/// The layout of nodes. Sides [0, faces) are the object's faces as wound, the next `faces` their backs. Nodes
/// are first those of the sides in order, n² a side (its atlas_triangles(n), by index), then the roof's
/// cells.
struct LightLayout {
  std::size_t faces = 0;
  std::vector<int> first_of_side;  ///< sides + 1: each side's first node
  std::vector<int> parts;          ///< of each side: n
  std::vector<int> side_of;        ///< side of each of the sides' nodes
  std::vector<bool> behind;        ///< of each face: the camera sees its back
  /// By n − 1: the node, of n², that shows each texel, and the texels that each node reflects with.
  std::vector<std::vector<int>> node_of_texel;
  std::vector<std::vector<std::vector<int>>> texels_of_node;

  /// The side that the camera sees of a face.
  std::size_t side(std::size_t face) const { return behind[face] ? face + faces : face; }
  /// The face of a side.
  std::size_t face_of(std::size_t side) const { return side < faces ? side : side - faces; }
  /// Index of a side's first node.
  std::size_t first_node(std::size_t side) const { return as_size(first_of_side[side]); }
  /// For each texel of a side's face, the node of the side that shows it.
  const std::vector<int>& nodes_of_texels(std::size_t side) const {
    return node_of_texel[as_size(parts[side]) - 1];
  }
  /// The node that shows a face's texel to the camera.
  std::size_t node(std::size_t face, std::size_t texel) const {
    const std::size_t seen = side(face);
    return first_node(seen) + as_size(nodes_of_texels(seen)[texel]);
  }
  /// The texels of its face that a node of a side reflects with.
  const std::vector<int>& texels_of(std::size_t node) const {
    const auto side = as_size(side_of[node]);
    return texels_of_node[as_size(parts[side]) - 1][node - first_node(side)];
  }
};

/// The rays' hits: values without a gradient.
struct LightVisibility : LightLayout {
  /// A node that another node's rays met.
  struct Reflection {
    int node = 0;        ///< the node hit
    Vec3f towards;       ///< ω times its weight
    float specular = 0;  ///< a_i f_k / Σ f_k: share of its radiance in the gloss
    float gloss = 0;     ///< a_ij: share of a uniform light that its own gloss sends along the ray
  };
  std::vector<Eigen::Matrix3d> blocked;  ///< of each node: Σ ω weight (L_fixed − L_sky)ᵀ, so that E += mᵀ n̂
  std::vector<int> first;                ///< nodes + 1: index of each node's first reflection
  std::vector<Reflection> reflections;
  TexelGrid shown;  ///< the parts shown of each face: its texels or parts of them
  /// By number of parts along a texel's edge, less one: the texel of each of a face's parts.
  std::vector<std::vector<int>> texel_of_part;
  int resolution = 1;             ///< the atlas's C
  std::vector<float> sun;         ///< of each shown part: share of it that sees the sun
  std::vector<double> sun_share;  ///< of each node
  // For sides that the camera sees; the others as without a camera.
  std::vector<Vec3d> specular;       ///< of each node: the gloss's share of sky, road and deck
  std::vector<double> specular_sun;  ///< of each node: π f_s(l) max(0, n̂·l)
  std::vector<double> diffuse;       ///< of each node: m_i
  std::vector<double> diffuse_sun;   ///< of each node: F_d(l)
  Vec3d roof_normal = Vec3d::UnitZ(), paint = Vec3d::Zero();
  std::size_t rays = 0;

  /// For each of a face's shown parts, the texel that contains it.
  const std::vector<int>& texels_of_parts(std::size_t face) const {
    return texel_of_part[as_size(shown.resolution_of(face) / resolution) - 1];
  }
  /// Number of nodes.
  std::size_t nodes() const { return sun_share.size(); }
  /// The nodes that a node's rays met.
  std::span<const Reflection> met_by(std::size_t node) const {
    return std::span(reflections).subspan(as_size(first[node]), as_size(first[node + 1] - first[node]));
  }
};

/// Traces the rays. `surroundings` may be null: an object in free space. `eye` is the camera's position,
/// which decides the visible sides; null: all fronts. The result depends on the light's values: the road's
/// and the sky's radiances are in `blocked`. InputError for an atlas without texels for each face, or a
/// setting that is not positive.
LightVisibility find_visibility(const TexturedMesh& placed, const Lighting& light,
                                const LightSurroundings* surroundings, const Vec3d* eye = nullptr,
                                const VisibleLightSettings& settings = {});

/// Light factor of every shown part (LightVisibility::shown), and the values that the VJP needs.
struct VisibleLight {
  std::vector<Vec3d> factor;              ///< of each part: multiplies its texel's albedo; never negative
  std::vector<Vec3d> gloss;               ///< of each part: added, independent of the albedo
  std::vector<std::vector<Vec3d>> skies;  ///< E of every node before each gathering step, less `direct`
  std::vector<Vec3d> direct;              ///< of every node: the sun's own part of E
  std::vector<Vec3d> albedo;              ///< of every node
  std::vector<Vec3d> sky;                 ///< of every node: all light but the sun's own, before max(0, ·)
  std::vector<double> weights;            ///< of every reflection: n̂·towards
};
/// `normals`: unnormalised, of the faces, `velo`; `texels`: the atlas's albedos. A face without area has the
/// ambient term only.
VisibleLight visible_light(const std::vector<Vec3d>& normals, const std::vector<Vec3d>& texels,
                           const Lighting& light, const LightVisibility& visibility, int bounces);
/// Adds d loss / d normal and d loss / d texel, given d loss / d factor and d loss / d gloss of every part.
void visible_light_vjp(const std::vector<Vec3d>& normals, const std::vector<Vec3d>& texels,
                       const Lighting& light, const LightVisibility& visibility, const VisibleLight& at,
                       const std::vector<Vec3d>& d_factor, const std::vector<Vec3d>& d_gloss,
                       std::vector<Vec3d>& d_normals, std::vector<Vec3d>& d_texels);

}  // namespace mirage
