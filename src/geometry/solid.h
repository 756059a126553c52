// The edges of a mesh, and the faces that meet there.
#pragma once

#include <array>
#include <vector>

#include "base/sizes.h"
#include "base/types.h"
#include "geometry/mesh.h"

namespace mirage {

// Signed distances sampled on a regular grid, read back by trilinear interpolation.

/// Nodes of a regular grid: node (i, j, k) stands at origin + spacing ∘ (i, j, k) and has the number
/// i + nx (j + ny k).
struct GridLayout {
  Vec3d origin = Vec3d::Zero();
  Vec3d spacing = Vec3d::Ones();  ///< m
  std::array<int, 3> count = {0, 0, 0};

  /// Number of nodes.
  std::size_t size() const { return as_size(count[0]) * as_size(count[1]) * as_size(count[2]); }
  /// Index of a node among the values: i runs fastest.
  std::size_t index(int i, int j, int k) const {
    return as_size(i) + as_size(count[0]) * (as_size(j) + as_size(count[1]) * as_size(k));
  }
  /// Position of a node (m).
  Vec3d node(int i, int j, int k) const { return origin + spacing.cwiseProduct(Vec3d(i, j, k)); }
};

/// The eight nodes around a point, their trilinear weights and the weights' derivatives (1/m) to the point.
/// A point outside the grid is moved to the grid's nearest point by `outside` (m). The gradients are 0 along
/// the axes on which it was moved.
struct GridCell {
  std::array<std::size_t, 8> nodes;
  std::array<double, 8> weights;
  std::array<Vec3d, 8> gradients;
  double outside = 0;
};
/// The cell around p, or around the nearest point of the grid where p is outside.
GridCell cell_at(const GridLayout& layout, const Vec3d& p);

/// Signed distances (m) at the nodes of a grid.
struct DistanceGrid {
  GridLayout layout;
  std::vector<float> values;  ///< m, negative inside; one a node

  /// Trilinear value at p (m); outside the grid, plus the distance to it.
  double at(const Vec3d& p) const;
};

/// An edge of one face or more.
struct MeshEdge {
  std::array<int, 2> vertices;  ///< the smaller first
  std::vector<int> faces;       ///< rising
};

/// Each edge once, sorted by vertices. A side whose two ends are one vertex is not an edge.
std::vector<MeshEdge> edges_of(const Mesh& mesh);

// Whether a closed mesh can be a solid: faces that cut each other, and how thick its walls are.

/// Pairs of faces (lower index first, each pair once) of which an edge of one passes through the other. Faces
/// with a common vertex are compared without the edges at it; faces with a common edge cannot cut each other
/// and count when they are folded flat onto each other. Touching without passing through does not count.
/// O(faces²) with boxes compared first: meant for meshes of hundreds of faces.
std::vector<std::array<int, 2>> intersecting_faces(const Mesh& mesh);

/// The thinnest wall found behind a face: `thickness` (m) and the face on the other side.
struct Wall {
  double thickness = 0;  ///< infinity if no face lies behind (an open mesh)
  int opposite = -1;
};
/// Measured from the centre of each face and of its three thirds, against the outward normal, to the next
/// face. Faces without area have no wall (infinity).
std::vector<Wall> walls(const Mesh& mesh);

// Generalised winding number of a triangle mesh: how often it wraps around a point.
//   w(p) = Σ_f Ω_f(p) / 4π,   Ω_f the signed solid angle of face f seen from p
// (Jacobson, Kavan, Sorkine-Hornung, SIGGRAPH 2013), 1 inside and 0 outside a closed mesh and a smooth value
// between them where it has holes, so that w > 1/2 means inside for meshes that aren't watertight. Clusters
// of far faces count as one dipole (Barill et al., SIGGRAPH 2018, first order).

/// Winding numbers of one mesh, prepared for many points.
class WindingNumber {
 public:
  /// Faces without area don't count. An empty mesh has w = 0 everywhere.
  explicit WindingNumber(const Mesh& mesh);
  /// w at p; error of the dipoles below about 0.02. `exact`: every face on its own.
  double at(const Vec3d& p, bool exact = false) const;

 private:
  struct Node {
    Vec3d centre = Vec3d::Zero();  ///< mean of the faces' centres, weighted by area
    Vec3d area = Vec3d::Zero();    ///< Σ area · unit normal
    double radius = 0;             ///< of a ball around `centre` that holds the faces
    int first = 0, count = 0;      ///< range in faces_
    int left = -1, right = -1;     ///< children, −1 in a leaf
  };
  int build(int first, int count);

  std::vector<std::array<Vec3d, 3>> faces_;
  std::vector<Node> nodes_;
};

// Zero surface of a distance grid as a closed mesh (Lorensen and Cline, SIGGRAPH 1987).

/// The surface value = 0, counter-clockwise seen from the positive side. Always watertight and consistently
/// wound: the triangles of the 256 cases are derived, not tabled. On each face of a cube the inside corners
/// are cut off one run at a time, which both cubes at that face do alike, and no diagonal of a polygon lies
/// in a face. Nodes on the grid's border count as outside, so that a body that reaches the border is closed
/// there. A value of exactly 0 counts as outside. Vertices are shared; none comes closer to a node than 1e-3
/// of an edge, so that no triangle is empty. An all-positive grid gives an empty mesh.
Mesh marching_cubes(const DistanceGrid& grid);

}  // namespace mirage
