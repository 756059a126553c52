// Convex polygons on screen whose edges know what they lie on, and cutting one along a line.
#pragma once

#include <cstdint>
#include <vector>

#include "base/types.h"

namespace mirage::coverage {

/// What an edge lies on, which says how it moves.
enum class On : std::int8_t {
  fixed,     ///< nothing of the mesh (the border of what is looked at)
  edge,      ///< an edge of a face
  texel,     ///< a border between texels of a face
  crossing,  ///< where two faces meet
  limit,     ///< where a face meets the depth limit
};

/// An edge of a polygon. Faces are indices of Visible::faces.
struct Side {
  On on = On::fixed;
  std::int8_t edge = 0;  ///< On::edge: which one, from the face's corner `edge` to the next
  int face = -1;
  int other = -1;  ///< On::crossing: the second face
};

/// A corner, and the edge from it to the next one.
struct Corner {
  Vec2d p;
  Side side;
};

/// Corners first … first + count − 1 of a pool, counter-clockwise in (x, y).
struct Polygon {
  int first = 0, count = 0;
  bool empty() const { return count == 0; }
};

/// A directed line; a point within `slack` counts as on it.
struct Line {
  Vec2d normal = Vec2d::Zero(), through = Vec2d::Zero();  ///< unit normal
  double slack = 0;
  double at(const Vec2d& p) const { return normal.dot(p - through); }
};

/// Polygons in common memory.
struct Pool {
  std::vector<Corner> corners;
  std::vector<double> distances;  ///< scratch

  const Corner& corner(const Polygon& polygon, int i) const {
    return corners[static_cast<std::size_t>(polygon.first + i)];
  }
  /// A copy of a polygon of another pool.
  Polygon copy(const Pool& from, const Polygon& polygon);
  double area(const Polygon& polygon) const;
};

/// Cuts: `front` is the part on the positive side, `back` the other; either may be empty, and what is not cut
/// stays the same polygon. Corners on the line belong to both. `cut` is what the new edge lies on.
void split(Pool& pool, Polygon polygon, const Line& line, const Side& cut, Polygon& front, Polygon& back);

}  // namespace mirage::coverage
