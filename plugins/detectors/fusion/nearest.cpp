#include "nearest.h"

#include <algorithm>
#include <cmath>

namespace mirage::fusion {
namespace {

constexpr double kNearestDepth = 0.5;  // m

/// Cells of the grid whose centres a point reaches, and a cell around them.
Window reached(const Grid& grid, double x, double y) {
  const auto first = [&](double at) {
    return std::max<std::int64_t>(0, std::llround(std::floor((at - grid.reach) / grid.cell)));
  };
  const auto last = [&](double at, std::int64_t count) {
    return std::min<std::int64_t>(count - 1, std::llround(std::floor((at + grid.reach) / grid.cell)));
  };
  return {first(x - kXMin), first(y - kYMin), last(x - kXMin, grid.rows) + 1,
          last(y - kYMin, grid.columns) + 1};
}

}  // namespace

std::optional<PixelDepth> seen_at(const float* p, const Projection& m, int width, int height) {
  const double w = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
  if (!(w > kNearestDepth)) return {};
  const double u = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / w;
  const double v = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / w;
  if (!(u >= -0.5 && u < width - 0.5 && v >= -0.5 && v < height - 0.5)) return {};
  return PixelDepth{u, v, w};
}

torch::Tensor projected(const torch::Tensor& points, const Projection& projection) {
  const std::vector<double> m(projection.begin(), projection.end());
  const torch::Tensor matrix = torch::tensor(m, points.dtype()).view({3, 4});
  return torch::matmul(points, matrix.narrow(1, 0, 3).t()) + matrix.select(1, 3);
}

torch::Tensor pixels_of(const torch::Tensor& points, const Projection& projection) {
  const torch::Tensor uvw = projected(points, projection);
  return uvw.narrow(1, 0, 2) / uvw.narrow(1, 2, 1);
}

torch::Tensor centres_of(std::span<const std::int64_t> cells, const Grid& grid) {
  torch::Tensor centres = torch::empty({static_cast<std::int64_t>(cells.size()), 3});
  float* centre = centres.data_ptr<float>();
  for (const std::int64_t cell : cells) {
    *centre++ = static_cast<float>(cell_x(cell / grid.columns, grid.cell));
    *centre++ = static_cast<float>(cell_y(cell % grid.columns, grid.cell));
    *centre++ = -1;  // halfway up a car
  }
  return centres;
}

Window cells_reached(const Grid& grid, const float* point) {
  return reached(grid, point[0], point[1]);
}

bool feeds_cells(const float* p, const Projection& projection, int width, int height) {
  return p[0] >= kXMin && p[0] < kXMax && p[1] >= kYMin && p[1] < kYMax && std::isfinite(p[2]) &&
         seen_at(p, projection, width, height);
}

std::vector<std::int64_t> nearest_in(const Grid& grid, std::span<const float> points,
                                     std::span<const std::int64_t> candidates, const Window& cells) {
  std::vector<std::int64_t> best(static_cast<std::size_t>(cells.area()), -1);
  std::vector<double> distance(best.size(), grid.reach * grid.reach);
  for (const std::int64_t i : candidates) {
    const double x = points[4 * i], y = points[4 * i + 1];
    const Window offered = intersection(reached(grid, x, y), cells);
    for (std::int64_t row = offered.top; row < offered.bottom; ++row) {
      const double dx = x - cell_x(row, grid.cell);
      for (std::int64_t column = offered.left; column < offered.right; ++column) {
        const double dy = y - cell_y(column, grid.cell), squared = dx * dx + dy * dy;
        const std::size_t at = (row - cells.top) * cells.columns() + column - cells.left;
        // Points are offered in their order: of two at the same distance the first one stays.
        if (squared > distance[at] || (squared == distance[at] && best[at] >= 0)) continue;
        distance[at] = squared;
        best[at] = i;
      }
    }
  }
  return best;
}

std::array<NearestPoints, kGrids.size()> nearest_points(std::span<const float> points,
                                                        const Projection& projection, int width, int height) {
  std::vector<std::int64_t> visible;
  for (std::size_t i = 0; i < points.size() / 4; ++i)
    if (feeds_cells(points.data() + 4 * i, projection, width, height))
      visible.push_back(static_cast<std::int64_t>(i));
  std::array<NearestPoints, kGrids.size()> nearest;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    const auto best = nearest_in(grid, points, visible, {0, 0, grid.rows, grid.columns});
    for (std::size_t cell = 0; cell < best.size(); ++cell) {
      if (best[cell] < 0) continue;
      nearest[level].cells.push_back(static_cast<std::int64_t>(cell));
      nearest[level].points.push_back(best[cell]);
    }
  }
  return nearest;
}

}  // namespace mirage::fusion
