// Polygons cut into triangles.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "base/types.h"

namespace mirage {

/// The n − 2 triangles of a polygon of n ≥ 3 corners, by the corners' numbers and wound as it is: ears are
/// cut off one by one (Meisters, "Polygons have ears", 1975) in the plane of its area vector (Newell's). A
/// polygon that is flat or crosses itself has no such triangles and is cut all the same. O(n²) for most
/// polygons, O(n³) at worst.
std::vector<std::array<int, 3>> cut_polygon(std::span<const Vec3d> corners);

}  // namespace mirage
