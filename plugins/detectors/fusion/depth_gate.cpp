#include "depth_gate.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_tensors.h"

namespace mirage::fusion {
namespace {

const double kRatio = std::log(1.4);
constexpr double kSoftness = 0.05;

}  // namespace

std::vector<std::int64_t> nearest_before(std::span<const float> points, const Projection& projection,
                                         int width, int height, std::span<const std::int64_t> indices) {
  const int columns = (width + kImageStride - 1) / kImageStride,
            rows = (height + kImageStride - 1) / kImageStride;
  struct Front {
    double depth = std::numeric_limits<double>::infinity();
    std::int64_t point = -1;
  };
  std::vector<Front> fronts(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows));
  const auto cell_of = [](double pixel) {
    return static_cast<int>(std::floor((pixel + 0.5) / kImageStride));
  };
  for (std::size_t i = 0; i < points.size() / 4; ++i) {
    const auto at = seen_at(points.data() + 4 * i, projection, width, height);
    if (!at) continue;
    Front& front = fronts[static_cast<std::size_t>(cell_of(at->v) * columns + cell_of(at->u))];
    if (at->depth < front.depth) front = {at->depth, static_cast<std::int64_t>(i)};
  }
  std::vector<std::int64_t> before(indices.begin(), indices.end());
  for (std::int64_t& point : before) {
    const auto at = seen_at(points.data() + 4 * point, projection, width, height);
    if (!at) continue;
    double nearest = at->depth;
    const int column = cell_of(at->u), row = cell_of(at->v);
    for (int r = std::max(0, row - 1); r <= std::min(rows - 1, row + 1); ++r)
      for (int c = std::max(0, column - 1); c <= std::min(columns - 1, column + 1); ++c)
        if (const Front& front = fronts[static_cast<std::size_t>(r * columns + c)]; front.depth < nearest) {
          nearest = front.depth;
          point = front.point;
        }
  }
  return before;
}

torch::Tensor depth_gate(const torch::Tensor& depth, const torch::Tensor& front) {
  return torch::sigmoid((kRatio - torch::log(depth / front)) / kSoftness);
}

}  // namespace mirage::fusion
