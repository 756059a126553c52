// Generalised winding number of a triangle mesh: how often it wraps around a point.
//   w(p) = Σ_f Ω_f(p) / 4π,   Ω_f the signed solid angle of face f seen from p
// (Jacobson, Kavan, Sorkine-Hornung, SIGGRAPH 2013), 1 inside and 0 outside a closed mesh and a smooth value
// between them where it has holes, so that w > 1/2 means inside for meshes that aren't watertight. Clusters
// of far faces count as one dipole (Barill et al., SIGGRAPH 2018, first order).
#pragma once

#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// Winding numbers of one mesh, prepared for many points.
class WindingNumber {
 public:
  /// Faces of no area count nothing. An empty mesh has w = 0 everywhere.
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

}  // namespace mirage
