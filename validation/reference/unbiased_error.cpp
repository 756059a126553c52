#include "validation/reference/unbiased_error.h"

#include <cmath>
#include <vector>

#include "base/error.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr int kTile = 8;  // px; noise of neighbouring pixels is nearly independent

bool same_size(const ImageF& a, const ImageF& b) {
  return a.width == b.width && a.height == b.height && a.channels == b.channels;
}

}  // namespace

ImageF Halves::mean() const {
  ImageF result = first;
  if (!second.empty())
    for (std::size_t i = 0; i < result.data.size(); ++i)
      result.data[i] = 0.5f * (first.data[i] + second.data[i]);
  return result;
}

double signed_root(double x) {
  return std::copysign(std::sqrt(std::abs(x)), x);
}

Interval signed_root(const Interval& square) {
  return {signed_root(square.value), signed_root(square.low), signed_root(square.high)};
}

SquaredError squared_error(const Halves& drawn, const Halves& reference, const ImageF& region, double pixels,
                           double mean) {
  const ImageF &a1 = drawn.first, &a2 = drawn.second.empty() ? a1 : drawn.second, &r1 = reference.first,
               &r2 = reference.second.empty() ? r1 : reference.second;
  if (!same_size(a1, a2) || !same_size(a1, r1) || !same_size(r1, r2) || region.width != a1.width ||
      region.height != a1.height)
    throw Failure("squared_error", "images of different size", "report this as a bug");
  SquaredError result;
  if (!(pixels > 0) || !(mean > 0)) return result;
  const double share = 1 / (pixels * a1.channels * mean * mean);
  const int columns = (a1.width + kTile - 1) / kTile, rows = (a1.height + kTile - 1) / kTile;
  std::vector<double> tiles(as_size(columns) * as_size(rows), 0.0);
  std::vector<bool> holds(tiles.size(), false);
  for (int v = 0; v < a1.height; ++v)
    for (int u = 0; u < a1.width; ++u) {
      if (!(region.at(u, v) > 0.5f)) continue;
      double plain = 0, own = 0, others = 0;
      for (int c = 0; c < a1.channels; ++c) {
        const double a_first = a1.at(u, v, c), a_second = a2.at(u, v, c), r_first = r1.at(u, v, c),
                     r_second = r2.at(u, v, c);
        const double off = (a_first + a_second - r_first - r_second) / 2;
        plain += off * off;
        own += (a_first - a_second) * (a_first - a_second) / 4;
        others += (r_first - r_second) * (r_first - r_second) / 4;
      }
      result.plain += share * plain;
      result.floor += share * (own + others);
      result.drawn += share * (plain - others);
      const std::size_t tile = as_size(v / kTile) * as_size(columns) + as_size(u / kTile);
      tiles[tile] += share * (plain - own - others);
      holds[tile] = true;
    }
  std::vector<double> used;
  for (std::size_t i = 0; i < tiles.size(); ++i)
    if (holds[i]) used.push_back(tiles[i]);
  result.unbiased = result.plain - result.floor;
  // The scale is the object's: a sum of as many tiles.
  const auto n = static_cast<double>(used.size());
  std::vector<double> without;
  for (const double tile : used) without.push_back((result.unbiased - tile) * n / (n - 1));
  const Interval over_tiles{result.unbiased, result.unbiased - result.floor, result.unbiased + result.floor};
  result.interval = signed_root(n > 1 ? plain_interval(jackknife(result.unbiased, without)) : over_tiles);
  return result;
}

}  // namespace mirage
