#include "nearest.h"

#include <cmath>

#include "region.h"

namespace mirage::fusion {
namespace {

constexpr double kReach = 2.4;         // m
constexpr double kNearestDepth = 0.5;  // m; also keeps the division by depth tame

bool seen(const float* p, const Projection& m, int width, int height) {
  const double w = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
  if (!(w > kNearestDepth)) return false;
  const double u = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / w;
  const double v = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / w;
  return u >= -0.5 && u < width - 0.5 && v >= -0.5 && v < height - 0.5;
}

class Field {
 public:
  Field(std::span<const float> points, std::int64_t rows, std::int64_t columns, double cell)
      : points_(points), rows_(rows), columns_(columns), cell_(cell), best_(rows * columns, -1) {
    distance_.assign(best_.size(), kReach * kReach);
  }

  void offer(std::int64_t row, std::int64_t column, std::int64_t point) {
    if (point < 0 || row < 0 || row >= rows_ || column < 0 || column >= columns_) return;
    const double dx = points_[4 * point] - cell_x(row, cell_),
                 dy = points_[4 * point + 1] - cell_y(column, cell_);
    const double distance = dx * dx + dy * dy;
    const std::int64_t at = row * columns_ + column;
    // The last returns of a sweep may sit on top of each other: the lower index wins a tie, always.
    if (distance > distance_[at] || (distance == distance_[at] && (best_[at] < 0 || point >= best_[at])))
      return;
    distance_[at] = distance;
    best_[at] = point;
  }

  void spread() {
    for (int pass = 0; pass < 4; ++pass) {
      const std::int64_t down = pass % 2 == 0 ? 1 : -1;
      for (std::int64_t r = 0; r < rows_; ++r) {
        const std::int64_t row = down > 0 ? r : rows_ - 1 - r;
        for (std::int64_t c = 0; c < columns_; ++c) pull(row, c, row - down);
        for (std::int64_t c = 1; c < columns_; ++c) offer(row, c, best_[row * columns_ + c - 1]);
        for (std::int64_t c = columns_ - 2; c >= 0; --c) offer(row, c, best_[row * columns_ + c + 1]);
      }
    }
  }

  NearestPoints result() const {
    NearestPoints nearest;
    for (std::size_t i = 0; i < best_.size(); ++i) {
      if (best_[i] < 0) continue;
      nearest.cells.push_back(static_cast<std::int64_t>(i));
      nearest.points.push_back(best_[i]);
    }
    return nearest;
  }

 private:
  void pull(std::int64_t row, std::int64_t column, std::int64_t from) {
    if (from < 0 || from >= rows_) return;
    for (std::int64_t k = -1; k <= 1; ++k)
      if (column + k >= 0 && column + k < columns_) offer(row, column, best_[from * columns_ + column + k]);
  }

  std::span<const float> points_;
  std::int64_t rows_, columns_;
  double cell_;
  std::vector<std::int64_t> best_;
  std::vector<double> distance_;
};

}  // namespace

NearestPoints nearest_points(std::span<const float> points, const Projection& projection, int width,
                             int height, std::int64_t rows, std::int64_t columns, double cell) {
  Field field(points, rows, columns, cell);
  for (std::size_t i = 0; i < points.size() / 4; ++i) {
    const float* p = points.data() + 4 * i;
    const double row = (p[0] - kXMin) / cell, column = (p[1] - kYMin) / cell;
    if (!(row >= 0 && row < static_cast<double>(rows) && column >= 0 &&
          column < static_cast<double>(columns)))
      continue;
    if (!std::isfinite(p[2]) || !seen(p, projection, width, height)) continue;
    field.offer(static_cast<std::int64_t>(row), static_cast<std::int64_t>(column),
                static_cast<std::int64_t>(i));
  }
  field.spread();
  return field.result();
}

}  // namespace mirage::fusion
