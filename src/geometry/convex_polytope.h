// Convex solids in space: the hull of points, cut by the sides of a box, and the point of it nearest to
// another.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "base/types.h"

namespace mirage {

/// A convex polytope with a volume, bounded by triangles.
class ConvexPolytope {
 public:
  /// The convex hull, by adding the point that is farthest outside of what there is (Barber, Dobkin,
  /// Huhdanpaa, "The Quickhull algorithm for convex hulls", ACM TOMS 1996). No point is farther outside than
  /// 1e-10. None of points that are not finite, or that a plane holds to within 1e-6.
  static std::optional<ConvexPolytope> hull(std::span<const Vec3d> points);
  /// The part inside the box; none if that has no volume.
  std::optional<ConvexPolytope> within(const Eigen::AlignedBox3d& box) const;

  /// Points of hull() that it needs, in their order.
  const std::vector<Vec3d>& corners() const { return corners_; }
  /// Distance to the farthest of the planes of the facets that `point` is beyond; up to 0 in the inside.
  double outside(const Vec3d& point) const;
  /// The point itself in the inside, else the nearest of the boundary: the nearest of all triangles that it
  /// is outside of (Ericson, "Real-Time Collision Detection", 2005, 5.1.5).
  Vec3d nearest(const Vec3d& point) const;

 private:
  struct Facet {
    std::array<int, 3> corners;  ///< counter-clockwise from outside
    Vec3d normal;                ///< outward, of length 1
    double offset;               ///< normal · x on the facet
    double beyond(const Vec3d& point) const { return normal.dot(point) - offset; }
  };
  ConvexPolytope(std::vector<Vec3d> corners, std::vector<Facet> facets);
  static std::optional<Facet> facet(std::span<const Vec3d> points, const std::array<int, 3>& corners);

  std::vector<Vec3d> corners_;
  std::vector<Facet> facets_;
};

}  // namespace mirage
