// Whether a closed mesh can be a solid: faces that cut each other, and how thick its walls are.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// Pairs of faces (lower index first, each pair once) of which an edge of one passes through the other. Faces
/// with a common vertex are compared without the edges at it; faces with a common edge cannot cut each other
/// and count when they are folded flat onto each other. Touching without passing through does not count.
/// O(faces²) with boxes compared first: meant for meshes of hundreds of faces.
std::vector<std::array<int, 2>> intersecting_faces(const Mesh& mesh);

/// The thinnest wall found behind a face: `thickness` (m) and the face on the other side.
struct Wall {
  double thickness = 0;  ///< infinity where nothing lies behind (an open mesh)
  int opposite = -1;
};
/// From the middle of each face and of its three thirds, straight inwards (against the outward normal) to the
/// next face. Faces without area have no wall (infinity).
std::vector<Wall> walls(const Mesh& mesh);

}  // namespace mirage
