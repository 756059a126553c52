// What has a light of its own in the light model with visibility (sensors/visible_light.h): the sides of the
// object's faces, parts of those that the camera sees large, and cells of the roof.
#pragma once

#include <span>
#include <vector>

#include "base/sizes.h"
#include "sensors/ray_pencil.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Where a node's rays start: a triangle or a cell, relative to LightNodes::centre and lifted off its plane.
struct LightLeaf {
  Vec3f corner, edge1, edge2, normal;
  /// The triangle's point of those barycentrics.
  Vec3f at(float b1, float b2) const { return corner + b1 * edge1 + b2 * edge2; }
};

/// The roof's cells: rows of columns.
struct RoofCells {
  int columns = 0, rows = 0;
};

/// Nodes [0, patches) are the sides'; the roof's cells follow, row by row.
struct LightNodes : LightLayout {
  Vec3d centre = Vec3d::Zero();
  std::vector<LightLeaf> leaves;  ///< of each node
  std::vector<LightLeaf> wholes;  ///< of each side
  std::vector<bool> seen;         ///< of each patch: the camera sees some of it; without a camera: of a front
  /// Where, starts of rays as LightLeaf::at, patch after patch; and patches + 1: where each one's start.
  /// Empty without a camera.
  std::vector<Vec3f> seen_points;
  std::vector<int> first_seen_point;
  std::vector<double> angles;  ///< of each side that the camera looks at: how large, sr; else 0
  std::vector<Vec3d> views;    ///< of each patch, towards the camera; empty where there is no gloss
  RoofCells cells;

  /// How many sides of faces there are.
  int sides() const { return static_cast<int>(wholes.size()); }
  /// How many parts the sides have, all together.
  int patches() const { return static_cast<int>(side_of.size()); }
  /// How many nodes there are: patches and the roof's cells.
  int nodes() const { return static_cast<int>(leaves.size()); }
  /// Whether the node is one that the camera sees.
  bool is_seen(int node) const { return node < patches() && seen[as_size(node)]; }
  /// Where the camera sees a patch.
  std::span<const Vec3f> points_seen(int patch) const {
    if (first_seen_point.empty()) return {};
    const int* first = &first_seen_point[as_size(patch)];
    return std::span(seen_points).subspan(as_size(first[0]), as_size(first[1] - first[0]));
  }
  /// Whether the camera may see some of a side.
  bool is_side_seen(std::size_t side) const { return parts[side] > 1 || is_seen(first_of_side[side]); }
};

/// Centroids (b0, b1) of the n² congruent triangles of a face, by their index in TexelAtlas's order. Made
/// once a thread.
const std::vector<Vec2d>& texel_centroids(int n);

/// Of each of the centroids of n² triangles, which of p² its own lies in. Made once a thread.
const std::vector<int>& texels_of_centroids(int n, int p);

/// Of each of the n² triangles, which others a shadow's border between two may also run through: those whose
/// centroids' barycentrics are about two triangles' edges away at most. Made once a thread.
const std::vector<std::vector<int>>& texel_neighbours(int n);

/// Which of the centroids of n² triangles stand for each of p² parts of the face: those within it, or else
/// the one whose triangle the part's own lies in. Made once a thread.
const std::vector<std::vector<int>>& centroids_within(int p, int n);

/// `pencil` holds the object alone, about `centre`; null for one without faces. `around` and `eye` as of
/// find_visibility.
LightNodes light_nodes(const TexturedMesh& placed, const Vec3d& centre, RayPencil* pencil,
                       const LightSurroundings* around, const Vec3d* eye,
                       const VisibleLightSettings& settings);

// What the rays of a light meet that miss the object (sensors/visible_light.h): sky, the roof under it, the
// vehicle's outline and the road.

class LightEnvironment {
 public:
  /// What meet() answers beside a cell.
  static constexpr int kSky = -1, kDeck = -2, kRoad = -3;

  /// Sky alone where `around` is null. Rays start relative to `centre` (velo). Both must outlive this.
  LightEnvironment(const Lighting& light, const LightSurroundings* around, const Vec3d& centre,
                   RoofCells cells);

  /// One direction, and the radiance that comes against it.
  struct Along {
    Vec3f towards;
    Eigen::Vector4f sky;  ///< and a 0
    Vec3f deck, road;
    Vec3f roof_sky, roof_sun;  ///< of the roof's gloss: sky, and the sun where it shines

    /// Where a ray crosses the roof's plane, from its start; and the start's height over it.
    Eigen::Matrix<float, 2, 3> crossing;
    Vec2f crossing_offset, deck_shift;
    Vec3f height;
    float height_offset = 0;
    bool falls = false;  ///< towards the roof's plane from above
    bool goes_down = false;
  };
  /// What a ray along `direction` (unit vector, `velo`) may meet.
  Along along(const Vec3d& direction) const;

  /// What a ray that misses the object meets: a cell (>= 0), kSky, kDeck or kRoad.
  int meet(const Along& along, const Vec3f& start) const;

 private:
  Vec3d sky(const Vec3d& direction) const;
  /// What the gloss of a flat surface under the open sky sends back of sky and sun, met along a direction. It
  /// is as rough and glossy as the object's: so are the vehicle and the road in the path tracer.
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
