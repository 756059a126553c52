// Uniform Laplacian smoothness: E = Σ_i ‖δ_i‖², δ_i = v_i − mean of v_i's neighbours (src/README.md).
#pragma once

#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// The uniform Laplacian of a mesh and the smoothness loss Σ‖δ‖².
class Laplacian {
 public:
  /// Neighbours come from the faces' edges; isolated vertices have δ = 0.
  explicit Laplacian(const Mesh& mesh);
  /// E and, added to `gradient` with the factor `weight`, weight · ∂E/∂v.
  double energy(const std::vector<Vec3d>& vertices, double weight, std::vector<Vec3d>& gradient) const;

 private:
  std::vector<std::vector<int>> neighbours_;
};

}  // namespace mirage
