#include "late.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "detection/car_in_picture.h"
#include "highest.h"
#include "loss.h"
#include "region.h"
#include "sensor_tensors.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr float kLeastProposal = -4, kLeastBox = -5;
constexpr std::size_t kMostProposals = 400, kMostBoxes = 200;
constexpr double kLeastIou = 0.01;
constexpr double kDistanceUnit = 70, kLogitUnit = 4;
constexpr int kInputs = 4;

double iou(const PictureBox& a, const float* b, int width, int height) {
  const double left = std::max(b[0], 0.f), top = std::max(b[1], 0.f);
  const double right = std::min<double>(b[2], width - 1), bottom = std::min<double>(b[3], height - 1);
  const double across = std::min(a.right, right) - std::max(a.left, left);
  const double down = std::min(a.bottom, bottom) - std::max(a.top, top);
  if (!(across > 0 && down > 0)) return 0;
  const double both = across * down;
  return both / ((a.right - a.left) * (a.bottom - a.top) + (right - left) * (bottom - top) - both);
}

}  // namespace

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
  const std::vector<std::int64_t> proposals = highest(logits, kLeastProposal, kMostProposals);
  if (proposals.empty() || !input.camera.defined()) return output;
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const std::vector<std::int64_t> boxes = highest(input.camera.logits, kLeastBox, kMostBoxes);
  const Tensor rectangles = input.camera.boxes.detach().to(torch::kFloat).contiguous();
  const Tensor points = input.points.detach().to(torch::kFloat).contiguous();
  const LowestReturns returns({points.data_ptr<float>(), static_cast<std::size_t>(points.numel())},
                              {kXMin, kXMax, kYMin, kYMax, kZMin, kZMax});
  const Tensor values = output.detach().to(torch::kFloat).reshape({kOutputs, -1}).contiguous();
  const std::int64_t cells = values.size(1);

  // One row a pair; a proposal's last row pairs it with nothing where it has no other.
  std::vector<std::int64_t> of_proposal, of_box, place;  // place: among its proposal's pairs
  std::int64_t most = 1;
  std::vector<float> fixed;  // IoU, distance, "there is a box"
  for (std::size_t k = 0; k < proposals.size(); ++k) {
    std::array<float, 6> coded{};
    for (int c = 0; c < 6; ++c) coded[c] = values.data_ptr<float>()[(kDx + c) * cells + proposals[k]];
    const MirageBox decoded = decode_box(proposals[k], coded);
    const BevBox box = {decoded.x, decoded.y, decoded.length, decoded.width, decoded.yaw};
    const auto distance = static_cast<float>(std::hypot(box.x, box.y) / kDistanceUnit);
    const auto seen = car_in_picture(box, returns.ground(box), input.projection, width, height);
    std::int64_t pairs = 0;
    for (std::size_t b = 0; seen && b < boxes.size(); ++b) {
      const double overlap = iou(*seen, rectangles.data_ptr<float>() + 4 * boxes[b], width, height);
      if (overlap < kLeastIou) continue;
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
  const Tensor given = torch::tensor(fixed).to(type.dtype()).view({-1, 3});
  const Tensor there = given.select(1, 2);
  const Tensor cell = torch::tensor(proposals), pair = torch::tensor(of_proposal);
  const Tensor ours = logits.index_select(0, cell).index_select(0, pair);
  const Tensor theirs = input.camera.logits.to(type.dtype()).index_select(0, torch::tensor(of_box)) * there +
                        (there - 1) * -kLeastBox * 2;
  const Tensor rows =
      torch::stack({given.select(1, 0), theirs / kLogitUnit, ours / kLogitUnit, given.select(1, 1)}, 1);
  const Tensor scored = last(torch::relu(third(torch::relu(second(torch::relu(first(rows))))))).select(1, 0);
  const auto count = static_cast<std::int64_t>(proposals.size());
  const Tensor table = torch::full({count, most}, -1e9, type).index_put({pair, torch::tensor(place)}, scored);
  const Tensor joined = table.amax(1);
  const Tensor changed = logits.index_copy(0, cell, joined).view_as(output.select(0, kLogit)).unsqueeze(0);
  return torch::cat({changed, output.narrow(0, kDx, kOutputs - 1)});
}

}  // namespace mirage::fusion
