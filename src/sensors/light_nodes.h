// What has a light of its own in the light model with visibility (sensors/visible_light.h): the sides of the
// object's faces, parts of those that the camera sees large, and cells of the roof.
#pragma once

#include <vector>

#include "sensors/ray_pencil.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Where a node's rays start: a triangle or a cell, relative to LightNodes::centre and lifted off its plane.
struct LightLeaf {
  Vec3f corner, edge1, edge2, normal;
  /// The triangle's point of those barycentrics.
  Vec3f at(float b1, float b2) const { return corner + b1 * edge1 + b2 * edge2; }
};

/// Nodes [0, patches) are the sides'; the roof's cells follow, row by row.
struct LightNodes : LightLayout {
  Vec3d centre = Vec3d::Zero();
  std::vector<LightLeaf> leaves;  ///< of each node
  std::vector<LightLeaf> wholes;  ///< of each side
  std::vector<bool> seen;         ///< of each patch: the camera sees some of it; without a camera: of a front
  /// Of each patch, where: starts of rays as LightLeaf::at. Empty without a camera.
  std::vector<std::vector<Vec3f>> seen_points;
  std::vector<double> angles;  ///< of each side that the camera looks at: how large, sr; else 0
  std::vector<Vec3d> views;    ///< of each patch, towards the camera; empty where there is no gloss
  int columns = 0, rows = 0;   ///< cells

  int sides() const { return static_cast<int>(wholes.size()); }
  int patches() const { return static_cast<int>(side_of.size()); }
  int nodes() const { return static_cast<int>(leaves.size()); }
  /// Whether the node is one that the camera sees.
  bool is_seen(int node) const { return node < patches() && seen[static_cast<std::size_t>(node)]; }
  /// Whether the camera may see some of a side.
  bool is_side_seen(std::size_t side) const { return parts[side] > 1 || is_seen(first_of_side[side]); }
};

/// Centroids (b0, b1) of the n² congruent triangles of a face, by their index in TexelAtlas's order.
std::vector<Vec2d> texel_centroids(int n);

/// Which of the centroids of n² triangles stand for each of p² parts of the face: those within it, or else
/// the one whose triangle the part's own lies in.
std::vector<std::vector<int>> centroids_within(int p, int n);

/// The same mesh with every texel as a face of its own, in the atlas's order.
TexturedMesh texels_as_faces(const TexturedMesh& mesh);

/// `pencil` holds the object alone, about `centre`; null for one without faces. `around` and `eye` as of
/// find_visibility.
LightNodes light_nodes(const TexturedMesh& placed, const Vec3d& centre, RayPencil* pencil,
                       const LightSurroundings* around, const Vec3d* eye,
                       const VisibleLightSettings& settings);

}  // namespace mirage
