// Triangle mesh with a per-face texture atlas in SoftRas's layout.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/sizes.h"
#include "base/types.h"

namespace mirage {

// How finely texels divide each face of a mesh. A TexelAtlas divides all faces alike; drawing may divide some
// more finely (light varies within some texels: sensors/visible_light.h).

/// C of each face and the index of its first texel. The C² texels of all faces form one face-major list;
/// within a face they have TexelAtlas's order.
struct TexelGrid {
  int resolution = 1;            ///< C of every face if the next is empty
  std::vector<int> resolutions;  ///< C of each face
  std::vector<int> first;        ///< index of each face's first texel; last entry: number of texels

  /// The same C for every face.
  TexelGrid(int all = 1) : resolution(all) {}
  /// A C for each face.
  explicit TexelGrid(std::vector<int> of_faces) : resolutions(std::move(of_faces)), first(1, 0) {
    for (const int c : resolutions) first.push_back(first.back() + c * c);
  }

  /// C of a face.
  int resolution_of(std::size_t face) const { return resolutions.empty() ? resolution : resolutions[face]; }
  /// Number of texels of a face.
  std::size_t texels_of(std::size_t face) const {
    const auto c = as_size(resolution_of(face));
    return c * c;
  }
  /// Index of a face's first texel.
  std::size_t first_texel(std::size_t face) const {
    return resolutions.empty() ? face * texels_of(face) : as_size(first[face]);
  }
  /// Number of faces that have `texels` texels in all.
  std::size_t faces_with(std::size_t texels) const {
    return resolutions.empty() ? texels / texels_of(0) : resolutions.size();
  }
};

// How TexelAtlas splits a face: SoftRas's square texels are C² congruent triangles.

/// Index within a face of the texel at barycentrics (b0, b1) (see TexelAtlas).
template <class S>
int texel_index(S b0, S b1, int resolution) {
  const S x = b0 * S(resolution), y = b1 * S(resolution);
  const int last = resolution - 1;
  const int ix = std::clamp(static_cast<int>(x), 0, last), iy = std::clamp(static_cast<int>(y), 0, last);
  // On the far edge x + y − ix − iy is 1 up to rounding: a tolerance picks the lower half.
  if (x + y - S(ix) - S(iy) <= 1 + S(64) * std::numeric_limits<S>::epsilon() * S(resolution))
    return iy * resolution + ix;
  return (last - iy) * resolution + (last - ix);
}

/// One of a face's C² congruent triangles: barycentrics (b0, b1) of its corners, wound as the face is, and
/// the index within the face of the texel that covers it (texel_index of what lies inside).
struct AtlasTriangle {
  std::array<Vec2d, 3> corners;
  int texel = 0;

  /// Its corners on a face with these vertices.
  std::array<Vec3d, 3> on(const std::array<Vec3d, 3>& face) const {
    const auto at = [&](const Vec2d& b) -> Vec3d {
      return b.x() * face[0] + b.y() * face[1] + (1 - b.x() - b.y()) * face[2];
    };
    return {at(corners[0]), at(corners[1]), at(corners[2])};
  }
};
/// The C² triangles of a face, C = `resolution`, row by row.
std::vector<AtlasTriangle> atlas_triangles(int resolution);

/// Vertices and counter-clockwise faces (seen from outside).
struct Mesh {
  std::vector<Vec3d> vertices;
  std::vector<Face> faces;

  /// The face's three vertices.
  std::array<Vec3d, 3> corners(const Face& face) const {
    const auto at = [&](std::size_t k) { return vertices[as_size(face[k])]; };
    return {at(0), at(1), at(2)};
  }
};

/// Texels of a face: C×C colours (scene-linear albedo in [0, 1]).
/// For barycentrics (b0, b1, b2) with x = b0·C, y = b1·C, ix = ⌊x⌋, iy = ⌊y⌋ clamped to C − 1, the texel is
/// iy·C + ix if (x + y − ix − iy) ≤ 1, and the mirrored (C−1−iy)·C + (C−1−ix) otherwise
/// (tests/sensors/test_soft_rasterizer_golden.cpp). It splits a face into C² congruent triangles.
struct TexelAtlas {
  int resolution = 5;         ///< C
  std::vector<Vec3d> texels;  ///< faces × C × C, face-major

  /// C².
  std::size_t per_face() const { return as_size(resolution) * as_size(resolution); }
};

/// A mesh with the texels of its faces; the adversary is one.
struct TexturedMesh {
  Mesh mesh;
  TexelAtlas atlas;
};

/// Throws InputError naming `where` if an index is out of range, a coordinate is not finite, or the atlas
/// does not have faces × C² texels (an empty atlas is allowed).
void check_mesh(const TexturedMesh& mesh, const std::string& where);

/// Unnormalised face normals (v1 − v0) × (v2 − v0).
std::vector<Vec3d> face_normals(const Mesh& mesh);
/// Signed volume; positive when a closed mesh is wound counter-clockwise outside.
double signed_volume(const Mesh& mesh);
/// True if every directed edge has exactly one opposite partner.
bool is_watertight(const Mesh& mesh);
/// Indices of the vertices that faces use, ascending, each once. Files may hold other vertices, which aren't
/// part of the surface: compute a mesh's extent from these only.
std::vector<std::size_t> used_vertices(const Mesh& mesh);
/// Smallest and largest coordinates of the vertices that faces use. {0, 0} for a mesh without faces.
Eigen::AlignedBox3d bounds(const Mesh& mesh);

// Simple meshes: the adversary's start and the building blocks of proxies and generated scenes.

/// Unit sphere from an icosahedron whose faces are split `subdivisions` times into four:
/// 10·4^n + 2 vertices and 20·4^n faces (n = 2: 162 and 320, the adversary's).
Mesh icosphere(int subdivisions);
/// Half lengths (m) of the box that an object on a roof may fill (Tu et al., CoRL 2021).
inline const Vec3d kRoofBox(0.8, 0.8, 0.5);
/// m; limits of an object's longest extent: nothing smaller or larger stands on a car's roof.
inline constexpr double kMinObject = 0.01, kMaxObject = 10;
/// icosphere(2) stretched to `share` of these half lengths (m), 5×5 mid-grey texels a face. Attacks start
/// from it, and it measures how much of an object each host would show.
TexturedMesh grey_ellipsoid(const Vec3d& half_lengths, double share = 1);
/// Axis-aligned box of the given full sizes, centred at the origin: 8 vertices, 12 faces.
Mesh box_mesh(const Vec3d& size);
/// Appends `part`, transformed, to `mesh`.
void append(Mesh& mesh, const Mesh& part, const Transform& mesh_from_part);

// Uniform Laplacian smoothness: E = Σ_i ‖δ_i‖², δ_i = v_i − mean of v_i's neighbours (src/README.md).

/// The uniform Laplacian of a mesh and the smoothness loss Σ‖δ‖².
class Laplacian {
 public:
  /// Neighbours come from the faces' edges; isolated vertices have δ = 0.
  explicit Laplacian(const Mesh& mesh);
  /// E and, added to `gradient` with the factor `weight`, weight · ∂E/∂v.
  double energy(const std::vector<Vec3d>& vertices, double weight, std::vector<Vec3d>& gradient) const;

 private:
  std::vector<std::vector<int>> neighbours_;
};

// Polygons cut into triangles.

/// The n − 2 triangles of a polygon of n ≥ 3 corners, by the corners' numbers and wound as it is: ears are
/// cut off one by one (Meisters, "Polygons have ears", 1975) in the plane of its area vector (Newell's). A
/// polygon that is flat or crosses itself has no such triangles and is cut all the same. O(n²) for most
/// polygons, O(n³) at worst.
std::vector<std::array<int, 3>> triangulate_polygon(std::span<const Vec3d> corners);

}  // namespace mirage
