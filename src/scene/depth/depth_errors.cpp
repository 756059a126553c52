#include "scene/depth/depth_errors.h"

#include <algorithm>
#include <cmath>

#include "scene/depth_completion.h"

namespace mirage {

DepthErrors depth_errors(const ImageF& truth, const ImageF& dense, double farthest,
                         const Image<std::uint8_t>& where) {
  DepthErrors e;
  double squares = 0, absolute = 0, inverse_squares = 0, inverse_absolute = 0;
  for (std::size_t i = 0; i < truth.data.size(); ++i) {
    const double t = truth.data[i], d = dense.data[i];
    if (!(t > 0) || t > farthest || (!where.empty() && !where.data[i])) continue;
    const double error = std::abs(d - t), inverse = std::abs(1 / d - 1 / t);
    squares += error * error;
    absolute += error;
    inverse_squares += inverse * inverse;
    inverse_absolute += inverse;
    ++e.pixels;
  }
  if (e.pixels == 0) return e;
  const double n = static_cast<double>(e.pixels);
  e.rmse = 1e3 * std::sqrt(squares / n);
  e.mae = 1e3 * absolute / n;
  e.irmse = 1e3 * std::sqrt(inverse_squares / n);
  e.imae = 1e3 * inverse_absolute / n;
  return e;
}

void MeanDepthErrors::add(const DepthErrors& errors) {
  if (errors.pixels == 0) return;
  ++pictures_;
  sum_.rmse += errors.rmse;
  sum_.mae += errors.mae;
  sum_.irmse += errors.irmse;
  sum_.imae += errors.imae;
  sum_.pixels += errors.pixels;
}

DepthErrors MeanDepthErrors::mean() const {
  DepthErrors mean = sum_;
  const double n = std::max(1, pictures_);
  for (double* value : {&mean.rmse, &mean.mae, &mean.irmse, &mean.imae}) *value /= n;
  return mean;
}

namespace {

/// Fills gaps of one line of `count` values, `step` apart. Inner gaps only where `inner`.
void fill_line(float* line, int count, int step, bool inner) {
  const auto at = [&](int i) -> float& { return line[static_cast<std::ptrdiff_t>(i) * step]; };
  int last = -1;  // the last value seen
  for (int i = 0; i < count; ++i) {
    if (at(i) >= kFarDepth) continue;
    if (last < 0) {
      for (int k = 0; k < i; ++k) at(k) = at(i);
    } else if (inner) {
      const float nearer = std::min(at(last), at(i));
      for (int k = last + 1; k < i; ++k) at(k) = nearer;
    }
    last = i;
  }
  if (last >= 0)
    for (int k = last + 1; k < count; ++k) at(k) = at(last);
}

}  // namespace

ImageF fill_as_benchmark(const ImageF& dense) {
  ImageF filled = dense;
  for (int v = 0; v < dense.height; ++v) fill_line(filled.pixel(0, v), dense.width, 1, true);
  for (int u = 0; u < dense.width; ++u) fill_line(filled.pixel(u, 0), dense.height, dense.width, false);
  return filled;
}

}  // namespace mirage
