// Visible parts as edges between texels, and how these edges move with the faces' corners.
#pragma once

#include <limits>
#include <vector>

#include "sensors/coverage/visible.h"

namespace mirage::coverage {

/// An end of an edge, and what carries it along the edge's normal. Along the edge it may go anywhere: what is
/// integrated over an edge depends on the line alone.
struct Point {
  Vec2d p;
  On on = On::fixed;
  std::int8_t edge = 0;
  int face = -1, other = -1;
  double a = 0, b = 0;  ///< edge: place along it; texel: barycentrics 0 and 1 on the face; limit: 1/depth
};

/// From point `from` to point `to`; texels of the two sides (−1: none). `inside` lies on the left in (x, y).
struct Edge {
  int from = 0, to = 0, inside = -1, outside = -1;
};

/// The edges of the pieces that outline_piece has appended.
struct Outline {
  std::vector<Point> points;
  std::vector<Edge> edges;
  // Scratch.
  Pool pool;
  std::vector<Polygon> cells, current;
  std::vector<Line> borders;
};

/// Appends the edges of a visible piece, divided by texels; of its part nearer than `limit` (m) only.
void outline_piece(const ScreenMesh<double>& mesh, const Visible& visible, const Piece& piece,
                   Outline& outline, double limit = std::numeric_limits<double>::infinity());

/// d loss / d what a screen face is made of, in pixels and metres, its corners as in ScreenFace.
struct FaceForce {
  Vec2d s[3] = {Vec2d::Zero(), Vec2d::Zero(), Vec2d::Zero()};
  double z[3] = {0, 0, 0};
  Vec3d barycentrics[3] = {Vec3d::Zero(), Vec3d::Zero(), Vec3d::Zero()};  ///< where faces are parts
};

/// What points' moves along `force` (d loss / d place, normal to their edge) are worth to the faces. Where
/// faces cross at less than kMinCrossing of their slopes, the line's speed is bounded by what it is there.
void add_forces(const ScreenMesh<double>& mesh, const Visible& visible, const Outline& outline,
                const std::vector<Vec2d>& force, double image_size, std::vector<FaceForce>& faces);

/// Least difference of the slopes at a crossing, as a share of them.
inline constexpr double kMinCrossing = 1e-6;

}  // namespace mirage::coverage
