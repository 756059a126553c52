// Rays of one pencil: all along one direction, or all from one point. In the plane across them a ray is a
// point and a face a triangle with a depth, so that first hits need no tree of boxes in space: two to five
// times as fast as Embree's packets for the thousands of rays of a light (sensors/visible_light.h;
// `mirage_bench --benchmark_filter=ray_pencil`). sensors/ray_caster.h traces other rays.
#pragma once

#include <memory>
#include <span>

#include "geometry/mesh.h"

namespace mirage {

/// One mesh, and the present pencil of rays to trace against it. Float32; one thread at a time.
class RayPencil {
 public:
  /// The first hit of a ray.
  struct Met {
    int face = -1;         ///< < 0: nothing
    float b1 = 0, b2 = 0;  ///< barycentrics of its vertices 1 and 2
  };

  /// Coordinates are relative to `origin` (m, the mesh's frame), and so are the rays. InputError for a vertex
  /// that is not finite, or a vertex index out of range.
  RayPencil(const Mesh& mesh, const Vec3d& origin);
  ~RayPencil();

  /// Sets the pencil to rays along `direction` (of any non-zero length).
  void along(const Vec3f& direction);
  /// Sets the pencil to rays from `point` around `axis` (any non-zero length). They hit only faces that are
  /// entirely in front: all vertices lie further along the axis than a thousandth of the mesh's size.
  void from(const Vec3f& point, const Vec3f& axis);

  /// First hits of rays of the present pencil: rays that start at `points`, or rays from its point through
  /// them. Both sides of a face count; a face seen edge-on is missed. A ray that is not finite hits nothing.
  /// met.size() == points.size().
  void intersect(std::span<const Vec3f> points, std::span<Met> met) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace mirage
