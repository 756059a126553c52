// Ray casting with Embree. A scene is static after construction; tracing is thread-safe.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "geometry/mesh.h"
#include "geometry/solid.h"

namespace mirage {

/// A ray: origin + t · direction for t in [t_min, t_max].
struct Ray {
  Vec3f origin, direction;  ///< direction need not be a unit vector; t is in its length
  float t_min = 0, t_max = 1e30f;
};

/// The first hit of a ray.
struct Hit {
  float t = -1;                  ///< ray parameter; < 0 without a hit
  int mesh = -1;                 ///< index of the mesh, in the constructor's order
  int face = -1;                 ///< index of its face
  float b1 = 0, b2 = 0;          ///< barycentrics of vertices 1 and 2; b0 = 1 − b1 − b2
  Vec3f normal = Vec3f::Zero();  ///< unnormalised face normal, wound as the face is
  /// Whether there is a hit.
  bool hit() const { return mesh >= 0; }
};

/// Rows of rays as arrays, one entry for each ray, for tracing in packets. Neighbours in a row should have
/// nearly the same direction (consecutive azimuths of one beam): packets of rows are several times faster
/// than rays in any other order.
struct RayTable {
  /// Number of rays in a packet.
  static constexpr std::size_t kPacket = 16;

  RayTable() = default;
  /// Room for rows × columns rays.
  RayTable(std::size_t rows, std::size_t columns);

  std::size_t rows = 0, columns = 0;
  std::size_t stride = 0;  ///< columns, rounded up to whole packets; the padding is not traced
  std::vector<float> origin[3], direction[3];  ///< x, y, z: rows × stride

  /// Index of a ray in the arrays.
  std::size_t index(std::size_t row, std::size_t column) const { return row * stride + column; }
  /// Origin of the ray at an index of the arrays.
  Vec3f origin_at(std::size_t i) const { return {origin[0][i], origin[1][i], origin[2][i]}; }
  /// Direction of the ray at an index of the arrays.
  Vec3f direction_at(std::size_t i) const { return {direction[0][i], direction[1][i], direction[2][i]}; }
  /// Sets a ray.
  void set(std::size_t row, std::size_t column, const Vec3f& from, const Vec3f& towards) {
    for (int c = 0; c < 3; ++c) {
      origin[c][index(row, column)] = from[c];
      direction[c][index(row, column)] = towards[c];
    }
  }
};

/// Hits of a table's rays, in the table's layout. Without a hit: t = −1, mesh = face = −1.
struct HitTable {
  std::vector<float> t, b1, b2;
  std::vector<int> mesh, face;
};

/// Traces rays against meshes (Embree).
class RayCaster {
 public:
  /// Builds one scene over all meshes (they are copied). Coordinates inside are float and relative to
  /// `origin`, and so are the rays: with an origin near the meshes, hits 10⁵ m off the frame's origin are as
  /// exact as hits there. InputError for a coordinate that is not finite, or a vertex index out of range.
  explicit RayCaster(std::span<const Mesh> meshes, const Vec3d& origin = Vec3d::Zero());
  ~RayCaster();
  /// Takes the other's scene.
  RayCaster(RayCaster&&) noexcept;
  /// Takes the other's scene.
  RayCaster& operator=(RayCaster&&) noexcept;

  /// Nearest hit (both sides of a face count). A ray that is not finite hits nothing.
  Hit intersect(const Ray& ray) const;
  /// Nearest hits of many rays, in parallel. hits.size() == rays.size().
  void intersect(std::span<const Ray> rays, std::span<Hit> hits) const;
  /// Nearest hits of a table, rows in parallel, in packets of 16 (fewer if the processor has narrower
  /// registers; `width` 1, 4, 8 or 16 sets it, 0: automatic). `hits` is resized as needed and can be reused
  /// without allocation.
  void intersect(const RayTable& rays, float t_min, float t_max, HitTable& hits, int width = 0) const;
  /// Unnormalised normal of a face, wound as the face is.
  Vec3f normal(int mesh, int face) const;
  /// Whether any face lies between t_min and t_max.
  bool occluded(const Ray& ray) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Distances to a triangle mesh by Embree's point queries, signed by the generalised winding number.

/// Static after construction; thread-safe. Single precision inside: about 1e-6 of the mesh's extent.
class MeshDistance {
 public:
  /// InputError for a mesh without faces.
  explicit MeshDistance(const Mesh& mesh);
  ~MeshDistance();

  /// Distance from p to the nearest point of any face (m, ≥ 0).
  double distance(const Vec3d& p) const;
  /// The same, negative inside by the winding number: w > 1/2, or |w| > 1/2 for a mesh wound inside out as a
  /// whole. Correct for closed meshes, for overlapping closed parts and, away from the holes, for meshes with
  /// holes. At a hole the surface is the smooth one with w = 1/2, but distances are still to the faces.
  double signed_distance(const Vec3d& p) const;
  /// Whether signed_distance(p) is negative.
  bool inside(const Vec3d& p) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Signed distances at the nodes of a grid, in parallel.
DistanceGrid distance_grid(const Mesh& mesh, const GridLayout& layout);

}  // namespace mirage
