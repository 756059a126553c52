// Which point feeds which cell of the bird's-eye view (Liang et al., ContFuse, ECCV 2018, with K = 1).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "region.h"
#include "torch_headers.h"
#include "window.h"

namespace mirage::fusion {

/// Row-major 3 × 4 projection: (u w, v w, w) = M (x, y, z, 1).
using Projection = std::array<double, 12>;

/// Where the camera sees a point (x, y, z): pixel and depth (m). Empty behind the camera, closer than half a
/// metre (which keeps the division tame) and outside the picture.
struct PixelDepth {
  double u, v, depth;
};
std::optional<PixelDepth> seen_at(const float* point, const Projection& projection, int width, int height);

/// points: n × 3. Rows (u w, v w, w) of the projection; differentiable.
torch::Tensor projected(const torch::Tensor& points, const Projection& projection);
/// projected()'s pixels (u, v), n × 2.
torch::Tensor pixels_of(const torch::Tensor& points, const Projection& projection);

/// The points that cells' offsets are taken from: n × 3.
torch::Tensor centres_of(std::span<const std::int64_t> cells, const Grid& grid);

/// cells[k] (row · columns + column) takes its image feature at points[k].
struct NearestPoints {
  std::vector<std::int64_t> cells, points;
};

/// For each cell of each grid the point nearest to its centre in the ground plane, within the grid's reach,
/// among the points that the camera sees (in front of it and inside width × height). `points`: N × 4 floats.
/// Of points at the same distance the first one counts. The selection is discrete and carries no gradient,
/// everything after it does.
std::array<NearestPoints, kGrids.size()> nearest_points(std::span<const float> points,
                                                        const Projection& projection, int width, int height);

/// Its parts. Whether a point (x, y, z) takes part: in the region, and seen by the camera.
bool feeds_cells(const float* point, const Projection& projection, int width, int height);
/// Cells that such a point may be nearest to.
Window cells_reached(const Grid& grid, const float* point);
/// For each cell of a window, row by row, the nearest of `candidates`, which are in the order of the points;
/// −1 where none is within reach.
std::vector<std::int64_t> nearest_in(const Grid& grid, std::span<const float> points,
                                     std::span<const std::int64_t> candidates, const Window& cells);

}  // namespace mirage::fusion
