// Zero surface of a distance grid as a closed mesh (Lorensen and Cline, SIGGRAPH 1987).
#pragma once

#include "geometry/distance_grid.h"
#include "geometry/mesh.h"

namespace mirage {

/// The surface value = 0, counter-clockwise seen from the positive side. Always watertight and consistently
/// wound: the triangles of the 256 cases are derived, not tabled. On each face of a cube the inside corners
/// are cut off one run at a time, which both cubes at that face do alike, and no diagonal of a polygon lies
/// in a face. Nodes on the grid's border count as outside, so that a body that reaches the border is closed
/// there. A value of exactly 0 counts as outside. Vertices are shared; none comes closer to a node than 1e-3
/// of an edge, so that no triangle is empty. An all-positive grid gives an empty mesh.
Mesh marching_cubes(const DistanceGrid& grid);

}  // namespace mirage
