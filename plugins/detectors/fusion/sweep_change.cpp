#include "sweep_change.h"

#include <algorithm>
#include <cstring>

namespace mirage::fusion {
using torch::Tensor;

bool touches(const Footprint& footprint, const Dirty& read) {
  for (std::int64_t row = footprint.top; row <= footprint.bottom; ++row) {
    const Dirty::Span& span = read.row(row);
    if (!span.empty() && footprint.left < span.high && footprint.right >= span.low) return true;
  }
  return false;
}

SweepChange sweep_change(const Tensor& clean, const Tensor& points) {
  constexpr std::size_t bytes = 4 * sizeof(float);
  const float *a = clean.data_ptr<float>(), *b = points.data_ptr<float>();
  const std::int64_t from = clean.size(0), to = points.size(0);
  SweepChange change;
  change.now.assign(static_cast<std::size_t>(from), -1);
  std::int64_t next = 0;  // of the clean sweep: all before it are settled
  for (std::int64_t i = 0; i < to; ++i) {
    std::int64_t at = next;
    while (at < from && std::memcmp(a + 4 * at, b + 4 * i, bytes) != 0) ++at;
    if (at == from) {
      change.fresh.push_back(i);
      continue;
    }
    for (; next < at; ++next) change.gone.push_back(next);
    change.now[static_cast<std::size_t>(at)] = i;
    next = at + 1;
  }
  for (; next < from; ++next) change.gone.push_back(next);
  return change;
}

std::array<std::vector<ChangedCell>, kGrids.size()> changed_cells(const CleanFrame& clean,
                                                                  const Tensor& points,
                                                                  const SweepChange& change,
                                                                  const Dirty& read) {
  const int width = static_cast<int>(clean.width), height = static_cast<int>(clean.height);
  const float *before = clean.points.data_ptr<float>(), *now = points.data_ptr<float>();
  std::vector<const float*> moved;  // points that came or went, where they matter
  for (const std::int64_t i : change.gone) moved.push_back(before + 4 * i);
  for (const std::int64_t i : change.fresh) moved.push_back(now + 4 * i);
  std::erase_if(moved, [&](const float* p) { return !feeds_cells(p, clean.projection, width, height); });
  // Points that may feed a cell near these.
  std::vector<std::int64_t> candidates;
  if (!moved.empty()) {
    const auto order = [](int axis) {
      return [axis](const float* p, const float* q) { return p[axis] < q[axis]; };
    };
    const auto [x0, x1] = std::minmax_element(moved.begin(), moved.end(), order(0));
    const auto [y0, y1] = std::minmax_element(moved.begin(), moved.end(), order(1));
    double far = 0;  // a cell within a point's reach has its own points within the same reach
    for (const Grid& grid : kGrids) far = std::max(far, 2 * grid.reach + grid.cell);
    for (std::int64_t i = 0; i < points.size(0); ++i) {
      const float* p = now + 4 * i;
      if (p[0] >= (*x0)[0] - far && p[0] <= (*x1)[0] + far && p[1] >= (*y0)[1] - far &&
          p[1] <= (*y1)[1] + far && feeds_cells(p, clean.projection, width, height))
        candidates.push_back(i);
    }
  }
  std::array<std::vector<ChangedCell>, kGrids.size()> changed;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    Dirty reached(grid.rows, grid.columns);
    for (const float* p : moved) reached.add(cells_reached(grid, p));
    std::vector<std::uint8_t> settled(clean.nearest[level].size(), 0);
    for (const Window& cells : reached.windows(256)) {
      const auto best = nearest_in(grid, {now, static_cast<std::size_t>(points.numel())}, candidates, cells);
      std::size_t k = 0;
      for (std::int64_t row = cells.top; row < cells.bottom; ++row)
        for (std::int64_t column = cells.left; column < cells.right; ++column, ++k) {
          const std::int64_t cell = row * grid.columns + column;
          if (row >= reached.rows() || column < reached.row(row).low || column >= reached.row(row).high)
            continue;  // not all of its points are candidates
          const std::int32_t was = clean.nearest[level][static_cast<std::size_t>(cell)];
          const std::int64_t same = was < 0 ? -1 : change.now[static_cast<std::size_t>(was)];
          if (best[k] == same && !(was >= 0 && same < 0)) continue;
          settled[static_cast<std::size_t>(cell)] = 1;
          changed[level].push_back({cell, best[k]});
        }
    }
    if (read.empty()) continue;
    for (std::size_t cell = 0; cell < settled.size(); ++cell) {
      const std::int32_t point = clean.nearest[level][cell];
      if (settled[cell] || point < 0 || !touches(clean.footprints[static_cast<std::size_t>(point)], read))
        continue;
      changed[level].push_back(
          {static_cast<std::int64_t>(cell), change.now[static_cast<std::size_t>(point)]});
    }
  }
  return changed;
}

}  // namespace mirage::fusion
