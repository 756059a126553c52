// Distances to a triangle mesh by Embree's point queries, signed by the generalised winding number.
#pragma once

#include <memory>

#include "geometry/distance_grid.h"
#include "geometry/mesh.h"

namespace mirage {

/// Static after construction; several threads may ask at once. Single precision inside: about 1e-6 of the
/// mesh's extent.
class MeshDistance {
 public:
  /// InputError for a mesh without faces.
  explicit MeshDistance(const Mesh& mesh);
  ~MeshDistance();
  /// Takes the other's state.
  MeshDistance(MeshDistance&&) noexcept;
  /// Takes the other's state.
  MeshDistance& operator=(MeshDistance&&) noexcept;

  /// Distance from p to the nearest point of any face (m, ≥ 0).
  double distance(const Vec3d& p) const;
  /// The same, negative where the winding number says inside: w > 1/2, or |w| > 1/2 for a mesh that is wound
  /// inside out as a whole. Right for closed meshes, for overlapping closed parts, and, away from the holes,
  /// for meshes with holes: there the surface is the smooth one on which w = 1/2, but distances still count
  /// to the faces.
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
