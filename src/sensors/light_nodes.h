// The nodes, with one light each, of the light model with visibility (sensors/visible_light.h): sides of the
// object's faces, parts of sides that the camera sees large, and cells of the roof.
#pragma once

#include <span>
#include <vector>

#include "base/sizes.h"
#include "sensors/ray_pencil.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Area where a node's rays start: a triangle or cell, relative to LightNodes::centre, lifted off its plane.
struct LightArea {
  Vec3f corner, edge1, edge2, normal;
  /// The triangle's point at these barycentrics.
  Vec3f at(float b1, float b2) const { return corner + b1 * edge1 + b2 * edge2; }
};

/// The roof's cells: rows of columns.
struct RoofCells {
  int columns = 0, rows = 0;
};

/// Nodes [0, patches) are the sides'; the roof's cells follow, row by row.
struct LightNodes : LightLayout {
  Vec3d centre = Vec3d::Zero();
  std::vector<LightArea> node_areas;  ///< of each node
  std::vector<LightArea> side_areas;  ///< of each side
  std::vector<bool> seen;             ///< of each patch: visible to the camera; without a camera: of a front
  /// Visible points, starts of rays as LightArea::at, patch after patch; and patches + 1: first index of each
  /// patch. Empty without a camera.
  std::vector<Vec3f> seen_points;
  std::vector<int> first_seen_point;
  std::vector<double> angles;  ///< of each side facing the camera: solid angle, sr; otherwise 0
  std::vector<Vec3d> views;    ///< of each patch, towards the camera; empty without gloss
  RoofCells cells;

  /// Number of sides of faces.
  int sides() const { return static_cast<int>(side_areas.size()); }
  /// Number of parts of all sides.
  int patches() const { return static_cast<int>(side_of.size()); }
  /// Number of nodes: patches and the roof's cells.
  int nodes() const { return static_cast<int>(node_areas.size()); }
  /// Whether the camera sees the node.
  bool is_seen(int node) const { return node < patches() && seen[as_size(node)]; }
  /// The points of a patch that the camera sees.
  std::span<const Vec3f> points_seen(int patch) const {
    if (first_seen_point.empty()) return {};
    const int* first = &first_seen_point[as_size(patch)];
    return std::span(seen_points).subspan(as_size(first[0]), as_size(first[1] - first[0]));
  }
  /// Whether the camera may see part of a side.
  bool is_side_seen(std::size_t side) const { return parts[side] > 1 || is_seen(first_of_side[side]); }
};

/// Centroids (b0, b1) of the n² congruent triangles of a face, in TexelAtlas's order. Computed once per
/// thread.
const std::vector<Vec2d>& texel_centroids(int n);

/// For each of n² triangles, the one of p² that contains its centroid. Computed once per thread.
const std::vector<int>& texels_of_centroids(int n, int p);

/// For each of the n² triangles, its neighbours that a shadow's border near it may also cross: those with
/// centroids within about two triangles' edges in barycentrics. Computed once per thread.
const std::vector<std::vector<int>>& texel_neighbours(int n);

/// For each of p² parts of the face, the centroids of n² triangles that represent it: those within it,
/// otherwise the one whose triangle contains the part's centroid. Computed once per thread.
const std::vector<std::vector<int>>& centroids_within(int p, int n);

/// Makes the nodes. `pencil`: the object only, about `centre`; null if it has no faces. `around` and `eye` as
/// of find_visibility.
LightNodes light_nodes(const TexturedMesh& placed, const Vec3d& centre, RayPencil* pencil,
                       const LightSurroundings* around, const Vec3d* eye,
                       const VisibleLightSettings& settings);

// Targets of a light's rays that miss the object (sensors/visible_light.h): sky, the roof under it, the
// vehicle's outline and the road.

class LightEnvironment {
 public:
  /// Results of meet() besides a cell.
  static constexpr int kSky = -1, kDeck = -2, kRoad = -3;

  /// Sky only if `around` is null. Rays start relative to `centre` (velo). Both must outlive this.
  LightEnvironment(const Lighting& light, const LightSurroundings* around, const Vec3d& centre,
                   RoofCells cells);

  /// One direction, and the radiance arriving from it.
  struct Along {
    Vec3f towards;
    Eigen::Vector4f sky;  ///< and a 0
    Vec3f deck, road;
    Vec3f roof_sky, roof_sun;  ///< of the roof's gloss: sky, and the sun if visible

    /// A ray's crossing of the roof's plane, and its start's height over it, linear in the start.
    Eigen::Matrix<float, 2, 3> crossing;
    Vec2f crossing_offset, deck_shift;
    Vec3f height;
    float height_offset = 0;
    bool falls = false;  ///< towards the roof's plane from above
    bool goes_down = false;
  };
  /// Radiances that a ray along `direction` (unit vector, `velo`) may meet.
  Along along(const Vec3d& direction) const;

  /// Target of a ray that misses the object: a cell (>= 0), kSky, kDeck or kRoad.
  int meet(const Along& along, const Vec3f& start) const;

 private:
  Vec3d sky(const Vec3d& direction) const;
  /// Reflection of sky and sun by the gloss of a flat surface under the open sky, seen along a direction. Its
  /// roughness and gloss are the object's, as for vehicle and road in the path tracer.
  struct Sheen {
    Vec3d sky = Vec3d::Zero(), sun = Vec3d::Zero();
  };
  Sheen sheen(const Vec3d& normal, const Vec3d& direction) const;
  Vec3d level_radiance(const Vec3d& albedo, const Vec3d& direction) const;

  const Lighting& light_;
  const LightSurroundings* around_;
  RoofCells cells_;
  Transform roof_from_velo_ = Transform::Identity();
  Vec3d centre_in_roof_ = Vec3d::Zero();
  Eigen::AlignedBox2f roof_, deck_;
  Vec2f cells_per_metre_ = Vec2f::Zero();
};

}  // namespace mirage
