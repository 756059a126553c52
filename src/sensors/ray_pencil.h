// Rays of one pencil: all along one direction, or all from one point. In the plane across them a ray is a
// point and a face a triangle with a depth, so what each meets first is found without walking a tree of
// boxes in space: two to five times as fast as Embree's packets for the thousands of rays of a light
// (sensors/visible_light.h; `mirage_bench --benchmark_filter=ray_pencil`). For other rays there is
// sensors/ray_caster.h.
#pragma once

#include <memory>
#include <span>

#include "geometry/mesh.h"

namespace mirage {

/// One mesh, and the pencil whose rays are traced against it at present. Float32; one thread at a time.
class RayPencil {
 public:
  /// What a ray meets first.
  struct Met {
    int face = -1;         ///< < 0: nothing
    float b1 = 0, b2 = 0;  ///< barycentrics of its vertices 1 and 2
  };

  /// Coordinates are relative to `origin` (m, the mesh's frame), and so are the rays. InputError: a vertex
  /// that is not finite, or a face that names none.
  RayPencil(const Mesh& mesh, const Vec3d& origin);
  ~RayPencil();

  /// Rays along `direction` (of any length but zero) from here on.
  void along(const Vec3f& direction);
  /// Rays from `point`, looking about `axis` (any length but zero), from here on. Only faces that lie before
  /// it as a whole are met: their vertices' share along the axis is above a thousandth of the mesh's size.
  void from(const Vec3f& point, const Vec3f& axis);

  /// What rays of the present pencil meet: those that start at `points`, or those from its point through
  /// them. Both sides of a face count; one that is seen edge on is not met. A ray that is not finite meets
  /// nothing. met.size() == points.size().
  void intersect(std::span<const Vec3f> points, std::span<Met> met) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace mirage
