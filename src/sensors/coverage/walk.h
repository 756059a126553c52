// The pixels that a straight edge crosses.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/types.h"

namespace mirage::coverage {

/// Follows the edge p → q through a grid of width × height unit pixels. Calls visit(i, j, dy, x, t, dt) for
/// each pixel (column i, row j) that it crosses: dy the height of the part inside, signed, x the middle of
/// that part in [0, 1] from the pixel's left, t the middle as a share of the edge, dt the part's share; and
/// left(j, dy) for what lies left of the grid in row j. What lies right of it, above or below is passed over.
template <class Visit, class Left>
void walk(const Vec2d& p, const Vec2d& q, int width, int height, const Visit& visit, const Left& left) {
  const double dx = q.x() - p.x(), dy = q.y() - p.y();
  const auto within = [&](const Vec2d& a) {
    return a.x() >= 0 && a.y() >= 0 && a.x() < width && a.y() < height;
  };
  if (within(p) && within(q)) {
    const int i = static_cast<int>(p.x()), j = static_cast<int>(p.y());
    if (i == static_cast<int>(q.x()) && j == static_cast<int>(q.y())) {
      visit(i, j, dy, (p.x() + q.x()) / 2 - i, 0.5, 1.0);
      return;
    }
  }
  constexpr double kNever = std::numeric_limits<double>::infinity();
  double begin = 0, end = 1;
  if (dy != 0) {
    const double top = -p.y() / dy, bottom = (height - p.y()) / dy;
    begin = std::max(begin, std::min(top, bottom));
    end = std::min(end, std::max(top, bottom));
  } else if (!(p.y() >= 0 && p.y() < height)) {
    return;
  }
  if (!(begin < end)) return;
  // Where it passes the grid's left and right sides.
  double inner_begin = begin, inner_end = end, left_begin = end, left_end = end;
  if (dx > 0) {
    const double enters = -p.x() / dx, leaves = (width - p.x()) / dx;
    left_begin = begin, left_end = std::min(end, enters);
    inner_begin = std::max(begin, enters), inner_end = std::min(end, leaves);
  } else if (dx < 0) {
    const double enters = (width - p.x()) / dx, leaves = -p.x() / dx;
    inner_begin = std::max(begin, enters), inner_end = std::min(end, leaves);
    left_begin = std::max(begin, leaves);
  } else if (p.x() < 0) {
    left_begin = begin, inner_end = inner_begin;
  } else if (p.x() >= width) {
    return;
  }
  const int step_i = dx > 0 ? 1 : -1, step_j = dy > 0 ? 1 : -1;
  const auto row_of = [&](double t) {
    return static_cast<int>(std::clamp(p.y() + dy * t, 0.0, height - 1.0));
  };
  // A border reached at the grid's side is none: rounding may have the edge end just before it.
  const auto next_row = [&](int j) {
    const int border = dy > 0 ? j + 1 : j;
    return dy == 0 || border == 0 || border == height ? kNever : (border - p.y()) / dy;
  };
  if (left_begin < left_end && dy != 0) {
    int j = row_of(left_begin);
    for (double t = left_begin; t < left_end; j += step_j) {
      const double to = std::clamp(next_row(j), t, left_end);
      left(j, dy * (to - t));
      t = to;
      if (to == left_end) break;
    }
  }
  if (!(inner_begin < inner_end)) return;
  const auto next_column = [&](int i) {
    const int border = dx > 0 ? i + 1 : i;
    return dx == 0 || border == 0 || border == width ? kNever : (border - p.x()) / dx;
  };
  int i = static_cast<int>(std::clamp(p.x() + dx * inner_begin, 0.0, width - 1.0)), j = row_of(inner_begin);
  double column = next_column(i), row = next_row(j);
  for (double t = inner_begin;;) {
    const double to = std::clamp(std::min(column, row), t, inner_end);
    if (to > t) {
      const double middle = (t + to) / 2;
      visit(i, j, dy * (to - t), p.x() + dx * middle - i, middle, to - t);
    }
    t = to;
    if (t >= inner_end) return;
    if (column <= row) {
      i += step_i;
      column = next_column(i);
    } else {
      j += step_j;
      row = next_row(j);
    }
  }
}

}  // namespace mirage::coverage
