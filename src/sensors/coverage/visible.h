// The visible parts of a mesh's faces: exact hidden-surface removal in the image plane.
//
// On screen 1/z of a face is a linear function of (x, y). So a face G hides the convex polygon G ∩ {1/z_G >
// 1/z_F} of a face F: F's visible part is F less these polygons, subtracted one after another (Weiler and
// Atherton 1977 for the idea). At a crossing of two faces the line 1/z_G = 1/z_F is an edge of both. Of two
// faces in one plane the first in the mesh is visible. Exact up to rounding: lengths below ScreenFace::slack
// count as 0.
#pragma once

#include <cstdint>
#include <vector>

#include "base/sizes.h"
#include "base/types.h"
#include "sensors/soft_rasterizer.h"

namespace mirage::coverage {

// Convex polygons on screen whose edges know their origin, and cutting a polygon along a line.

/// The origin of an edge, which determines its motion.
enum class On : std::int8_t {
  fixed,     ///< not on the mesh (border of the region)
  edge,      ///< an edge of a face
  texel,     ///< a border between texels of a face
  crossing,  ///< line where two faces cross
  limit,     ///< line where a face meets the depth limit
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
  /// Whether it has no corners.
  bool empty() const { return count == 0; }
};

/// A directed line; a point within `slack` counts as on it.
struct Line {
  Vec2d normal = Vec2d::Zero(), through = Vec2d::Zero();  ///< unit normal
  double slack = 0;
  /// Signed distance from the line, positive where the normal points.
  double at(const Vec2d& p) const { return normal.dot(p - through); }
};

/// Polygons in common memory.
struct Pool {
  std::vector<Corner> corners;
  std::vector<double> distances;  ///< scratch

  /// Corner i of the polygon, 0 to count − 1.
  const Corner& corner(const Polygon& polygon, int i) const { return corners[as_size(polygon.first + i)]; }
  /// A copy of a polygon of another pool.
  Polygon copy(const Pool& from, const Polygon& polygon);
  /// Signed area (px²): positive for counter-clockwise corners; 0 for an empty polygon.
  double area(const Polygon& polygon) const;
};

/// Cuts a polygon: `front` is the part on the positive side, `back` the other. Either may be empty; an uncut
/// polygon stays the same. Corners on the line belong to both. `cut`: origin of the new edge.
void split(Pool& pool, Polygon polygon, const Line& line, const Side& cut, Polygon& front, Polygon& back);

/// A face in pixels of the window: x right, y down, pixel (i, j) of the window is [i, i + 1] × [j, j + 1].
struct ScreenFace {
  int face = 0;              ///< in the screen mesh
  int corner[3] = {};        ///< index of each of these in its corners; here counter-clockwise in (x, y)
  Vec2d s[3];                ///< pixels
  double z[3], inv_z[3];     ///< m, 1/m
  Vec2d normal[3];           ///< inward unit normal of the edge from corner k to the next
  double inv_altitude[3];    ///< over edge k, 1/px
  Vec2d slope;               ///< gradient of 1/z
  double nearest, farthest;  ///< 1/z, largest and smallest
  Vec2d low, high;           ///< bounding box
  double slack;              ///< px: rounding of its corners

  /// Screen-space barycentrics of any point of the plane.
  Vec3d barycentrics(const Vec2d& p) const {
    Vec3d b;
    for (int k = 0; k < 3; ++k)
      b[k] = normal[(k + 1) % 3].dot(p - s[(k + 1) % 3]) * inv_altitude[(k + 1) % 3];
    return b;
  }
  /// 1/z (1/m) of the face's plane at a point of the window.
  double inv_depth(const Vec2d& p) const { return inv_z[0] + slope.dot(p - s[0]); }
};

/// A visible part.
struct Piece {
  int face = 0;  ///< of Visible::faces
  Polygon polygon;
  bool whole = false;  ///< all of the face
};

/// The result of find_visible.
struct Visible {
  std::vector<ScreenFace> faces;  ///< finite, with an area, in front of the camera, near the image
  std::vector<Piece> pieces;      ///< by face
  Pool pool;
  double area = 0;  ///< px²: of all pieces, to one image's size beyond the image
};

/// Fills `visible`. Faces are cut at one image's size beyond the image on each side.
void find_visible(const ScreenMesh<double>& mesh, int width, int height, const PixelRect& window,
                  Visible& visible);

}  // namespace mirage::coverage
