#include "painting.h"

#include <cmath>

#include "bilinear.h"
#include "region.h"
#include "sensor_tensors.h"

namespace mirage::fusion {

using torch::Tensor;

Tensor painted_voxels(const SensorTensors& input, const Window& within) {
  const auto type = input.points.options();
  const Tensor nothing = torch::zeros({1, kPaintedChannels, kVoxelsX, kVoxelsY}, type);
  if (!input.camera.defined()) return nothing;
  Tensor all = input.points.narrow(1, 0, 3), masses;
  if (input.watched.defined()) {
    all = torch::cat({all, input.watched.narrow(1, 0, 3)});
    masses = torch::cat({torch::ones({input.points.size(0)}, type), input.masses});
  }
  if (all.size(0) == 0) return nothing;
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const Tensor rows = all.detach().to(torch::kFloat).contiguous();
  const float* p = rows.data_ptr<float>();
  // Which columns a return reaches is discrete; its shares of them are not.
  std::vector<std::int64_t> visible, column_x, column_y;
  for (std::int64_t i = 0; i < rows.size(0); ++i, p += 3) {
    const double x = (p[0] - kXMin) / kVoxel - 0.5, y = (p[1] - kYMin) / kVoxel - 0.5;
    if (!(x > 0 && x < kVoxelsX - 1 && y > 0 && y < kVoxelsY - 1 && std::isfinite(p[2]))) continue;
    const auto low_row = static_cast<std::int64_t>(x), low_column = static_cast<std::int64_t>(y);
    if (low_row + 1 < within.top || low_row >= within.bottom || low_column + 1 < within.left ||
        low_column >= within.right)
      continue;
    if (!seen_at(p, input.projection, width, height)) continue;
    visible.push_back(i);
    column_x.push_back(low_row);
    column_y.push_back(low_column);
  }
  if (visible.empty()) return nothing;
  const Tensor which = torch::tensor(visible), points = all.index_select(0, which);
  const Tensor evidence = torch::sigmoid(
      bilinear(input.camera.mask, places_in_map(pixels_of(points, input.projection), kMaskStride))
          .select(1, 0));
  const Tensor low_x = torch::tensor(column_x), low_y = torch::tensor(column_y);
  const Tensor along = (points.select(1, 0) - kXMin) / kVoxel - 0.5 - low_x.to(type.dtype()),
               across = (points.select(1, 1) - kYMin) / kVoxel - 0.5 - low_y.to(type.dtype());
  std::vector<Tensor> cells, shares;
  for (int upper_x : {0, 1})
    for (int upper_y : {0, 1}) {
      cells.push_back((low_x + upper_x) * kVoxelsY + low_y + upper_y);
      shares.push_back((upper_x ? along : 1 - along) * (upper_y ? across : 1 - across));
      if (masses.defined()) shares.back() = shares.back() * masses.index_select(0, which);
    }
  const Tensor cell = torch::cat(cells), share = torch::cat(shares), four = evidence.repeat({4});
  const Tensor empty = torch::zeros({kVoxelsX * kVoxelsY}, type);
  const Tensor vehicle = empty.index_add(0, cell, share * four),
               other = empty.index_add(0, cell, share * (1 - four));
  const Tensor mass = 1 + vehicle + other;
  return torch::stack({vehicle / mass, other / mass}).view({1, kPaintedChannels, kVoxelsX, kVoxelsY});
}

}  // namespace mirage::fusion
