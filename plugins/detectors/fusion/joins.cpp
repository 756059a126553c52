#include "joins.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "loss.h"
#include "second_stage.h"
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
  // The choice of a return's columns is discrete; its shares in them are not.
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
  const Tensor evidence =
      torch::sigmoid(features_at(input.camera.mask, points, input.projection, kMaskStride).select(1, 0));
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

namespace {

const double kRatio = std::log(1.4);
constexpr double kSoftness = 0.05;

constexpr float kMinProposalLogit = -4, kMinBoxLogit = -5;
constexpr std::size_t kMaxProposals = 400, kMaxBoxes = 200;
constexpr double kMinIou = 0.01;
constexpr double kDistanceUnit = 70, kLogitUnit = 4;
constexpr int kInputs = 4;

}  // namespace

std::vector<std::int64_t> nearest_before(std::span<const float> points, const Projection& projection,
                                         int width, int height, std::span<const std::int64_t> indices) {
  const int columns = (width + kFeatureStride - 1) / kFeatureStride,
            rows = (height + kFeatureStride - 1) / kFeatureStride;
  struct Front {
    double depth = std::numeric_limits<double>::infinity();
    std::int64_t point = -1;
  };
  std::vector<Front> fronts(as_size(columns) * as_size(rows));
  const auto cell_of = [](double pixel) {
    return static_cast<int>(std::floor((pixel + 0.5) / kFeatureStride));
  };
  for (std::size_t i = 0; i < points.size() / 4; ++i) {
    const auto at = seen_at(points.data() + 4 * i, projection, width, height);
    if (!at) continue;
    Front& front = fronts[as_size(cell_of(at->v) * columns + cell_of(at->u))];
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
        if (const Front& front = fronts[as_size(r * columns + c)]; front.depth < nearest) {
          nearest = front.depth;
          point = front.point;
        }
  }
  return before;
}

torch::Tensor depth_gate(const torch::Tensor& depth, const torch::Tensor& front) {
  return torch::sigmoid((kRatio - torch::log(depth / front)) / kSoftness);
}

LateJoinImpl::LateJoinImpl() {
  first = register_module("first", torch::nn::Linear(kInputs, 18));
  second = register_module("second", torch::nn::Linear(18, 36));
  third = register_module("third", torch::nn::Linear(36, 36));
  last = register_module("last", torch::nn::Linear(36, 1));
}

Tensor LateJoinImpl::forward(const Tensor& output, const SensorTensors& input) {
  // In float even where convolutions run in bfloat16: rows of 36 gain nothing from it.
  const c10::impl::ExcludeDispatchKeyGuard in_float(c10::DispatchKey::AutocastCPU);
  const Tensor logits = output.select(0, kLogit).reshape({-1});
  const std::vector<std::int64_t> proposals = highest(logits, kMinProposalLogit, kMaxProposals);
  if (proposals.empty() || !input.camera.defined()) return output;
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const std::vector<std::int64_t> boxes = highest(input.camera.logits, kMinBoxLogit, kMaxBoxes);
  const Tensor rectangles = input.camera.boxes.detach().to(torch::kFloat).contiguous();
  const Tensor points = input.points.detach().to(torch::kFloat).contiguous();
  const LowestReturns returns({points.data_ptr<float>(), as_size(points.numel())});
  const Tensor values = output.detach().to(torch::kFloat).contiguous();

  // One row a pair; a proposal's last row pairs it with nothing where it has no other.
  std::vector<std::int64_t> of_proposal, of_box, place;  // place: among its proposal's pairs
  std::int64_t most = 1;
  std::vector<float> fixed;  // IoU, distance, "there is a box"
  for (std::size_t k = 0; k < proposals.size(); ++k) {
    const BevBox box = bev_box(decode_box(values.data_ptr<float>(), proposals[k]));
    const auto distance = static_cast<float>(horizontal_distance(box) / kDistanceUnit);
    const auto seen = car_in_picture(box, returns.ground(box), input.projection, width, height);
    std::int64_t pairs = 0;
    for (std::size_t b = 0; seen && b < boxes.size(); ++b) {
      const float* other = rectangles.data_ptr<float>() + 4 * boxes[b];
      const double overlap = iou(*seen, within({other[0], other[1], other[2], other[3]}, width, height));
      if (overlap < kMinIou) continue;
      of_proposal.push_back(static_cast<std::int64_t>(k));
      of_box.push_back(boxes[b]);
      place.push_back(pairs++);
      fixed.insert(fixed.end(), {static_cast<float>(overlap), distance, 1});
    }
    most = std::max(most, pairs);
    if (pairs > 0) continue;
    of_proposal.push_back(static_cast<std::int64_t>(k));
    of_box.push_back(0);
    place.push_back(0);
    fixed.insert(fixed.end(), {-1, distance, 0});
  }
  const auto type = output.options();
  const Tensor fixed_rows = torch::tensor(fixed).to(type.dtype()).view({-1, 3});
  const Tensor there = fixed_rows.select(1, 2);
  const Tensor cell = torch::tensor(proposals), pair = torch::tensor(of_proposal);
  const Tensor ours = logits.index_select(0, cell).index_select(0, pair);
  const Tensor theirs = input.camera.logits.to(type.dtype()).index_select(0, torch::tensor(of_box)) * there +
                        (there - 1) * -kMinBoxLogit * 2;
  const Tensor rows = torch::stack(
      {fixed_rows.select(1, 0), theirs / kLogitUnit, ours / kLogitUnit, fixed_rows.select(1, 1)}, 1);
  const Tensor scored = last(torch::relu(third(torch::relu(second(torch::relu(first(rows))))))).select(1, 0);
  const auto count = static_cast<std::int64_t>(proposals.size());
  const Tensor table = torch::full({count, most}, -1e9, type).index_put({pair, torch::tensor(place)}, scored);
  const Tensor maxima = table.amax(1);
  const Tensor changed = logits.index_copy(0, cell, maxima).view_as(output.select(0, kLogit)).unsqueeze(0);
  return torch::cat({changed, output.narrow(0, kDx, kOutputs - 1)});
}

}  // namespace mirage::fusion
