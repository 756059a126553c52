// Convex solids in space: the hull of points, its intersection with a box, and its nearest point to another
// point.
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
  /// The convex hull; each step adds the point farthest outside the hull so far (Barber, Dobkin, Huhdanpaa,
  /// "The Quickhull algorithm for convex hulls", ACM TOMS 1996). No point is farther outside than 1e-10.
  /// Nullopt if a coordinate is not finite or reaches 1e6, or if a plane contains all to within 1e-6.
  static std::optional<ConvexPolytope> hull(std::span<const Vec3d> points);
  /// The part inside the box; nullopt if it has no volume.
  std::optional<ConvexPolytope> within(const Eigen::AlignedBox3d& box) const;

  /// The points of hull() that are its corners, in their order.
  const std::vector<Vec3d>& corners() const { return corners_; }
  /// Largest signed distance of `point` to a facet's plane; at most 0 inside.
  double outside(const Vec3d& point) const;
  /// The point itself if inside, otherwise the nearest boundary point: the nearest of all triangles that it
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
