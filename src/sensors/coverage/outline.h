// Visible parts as edges between texels, and the motion of these edges with the faces' corners.
#pragma once

#include <limits>
#include <vector>

#include "sensors/coverage/visible.h"

namespace mirage::coverage {

/// An end of an edge, and the feature that moves it along the edge's normal. Its motion along the edge does
/// not matter: an integral over an edge depends on the line only.
struct Point {
  Vec2d p;
  On on = On::fixed;
  std::int8_t edge = 0;
  int face = -1, other = -1;
  double a = 0, b = 0;  ///< edge: position along it; texel: barycentrics 0 and 1 on the face; limit: 1/depth
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

/// Appends the edges of a visible piece, divided by texels; only its part nearer than `limit` (m).
void outline_piece(const ScreenMesh<double>& mesh, const Visible& visible, const Piece& piece,
                   Outline& outline, double limit = std::numeric_limits<double>::infinity());

/// d loss / d corners of a screen face, in pixels and metres; corners as in ScreenFace.
struct FaceGradient {
  Vec2d s[3] = {Vec2d::Zero(), Vec2d::Zero(), Vec2d::Zero()};
  double z[3] = {0, 0, 0};
  Vec3d barycentrics[3] = {Vec3d::Zero(), Vec3d::Zero(), Vec3d::Zero()};  ///< for parts of faces
};

/// Adds the gradient of the points, `edge_gradients` (d loss / d position, normal to their edge), to the
/// faces. Where faces cross at less than kMinCrossing of their slopes, the line's speed is bounded by its
/// value there.
void add_edge_gradients(const ScreenMesh<double>& mesh, const Visible& visible, const Outline& outline,
                        const std::vector<Vec2d>& edge_gradients, double image_size,
                        std::vector<FaceGradient>& faces);

/// Least difference of the slopes at a crossing, as a share of them.
inline constexpr double kMinCrossing = 1e-6;

}  // namespace mirage::coverage
