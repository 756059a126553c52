// Triangle mesh with a per-face texture atlas in SoftRas's layout.
#pragma once

#include <string>
#include <vector>

#include "base/types.h"

namespace mirage {

/// Vertices and counter-clockwise faces (seen from outside).
struct Mesh {
  std::vector<Vec3d> vertices;
  std::vector<Face> faces;
};

/// Texels of a face: C×C colours (scene-linear albedo in [0, 1]).
/// For barycentrics (b0, b1, b2) with x = b0·C, y = b1·C, ix = ⌊x⌋, iy = ⌊y⌋ clamped to C − 1, the texel is
/// iy·C + ix if (x + y − ix − iy) ≤ 1, and the mirrored (C−1−iy)·C + (C−1−ix) otherwise
/// (src/README.md, Liu et al.'s public code). It splits a face into C² congruent triangles.
struct TexelAtlas {
  int resolution = 5;         ///< C
  std::vector<Vec3d> texels;  ///< faces × C × C, face-major

  /// C².
  std::size_t per_face() const { return static_cast<std::size_t>(resolution) * resolution; }
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
/// Indices of the vertices that faces use, ascending, each once. Files hold others too, and those are no part
/// of the surface: whatever asks where a mesh lies asks these.
std::vector<std::size_t> used_vertices(const Mesh& mesh);
/// Smallest and largest coordinates of the vertices that faces use. {0, 0} for a mesh without faces.
Eigen::AlignedBox3d bounds(const Mesh& mesh);

}  // namespace mirage
