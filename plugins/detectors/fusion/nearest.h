// Which point feeds which cell of the bird's-eye view (Liang et al., ContFuse, ECCV 2018, with K = 1).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace mirage::fusion {

/// Row-major 3 × 4 projection: (u w, v w, w) = M (x, y, z, 1).
using Projection = std::array<double, 12>;

/// cells[k] (row · columns + column) takes its image feature at points[k].
struct NearestPoints {
  std::vector<std::int64_t> cells, points;
};

/// For each cell the point nearest to its centre in the ground plane, within 2.4 m, among the points that
/// the camera sees (in front of it and inside width × height). `points`: N × 4 floats. Each cell offers
/// its best point to its neighbours in four raster passes, so a nearer point may be missed by a fraction of a
/// cell; the selection is discrete and carries no gradient, everything after it does.
NearestPoints nearest_points(std::span<const float> points, const Projection& projection, int width,
                             int height, std::int64_t rows, std::int64_t columns, double cell);

}  // namespace mirage::fusion
