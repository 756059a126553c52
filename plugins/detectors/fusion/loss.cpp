#include "loss.h"

#include <algorithm>
#include <cmath>

#include "region.h"
#include "sensor_tensors.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kPositiveRadius = 0.4;  // of the half-extents
constexpr double kBoxRadius = 0.7;       // the box term also trains the cells around the positive ones
constexpr double kHeatSigma = 0.45;
constexpr double kBoxWeight = 2.0;  // weight of the box term

template <class Visit>
void for_each_cell(const MirageBox& box, const Visit& visit) {
  const double reach = std::hypot(box.length, box.width) * 0.75 + kCell;
  const auto bound = [](double at, std::int64_t size) {
    return std::clamp(static_cast<std::int64_t>(std::floor(at)), std::int64_t{0}, size - 1);
  };
  const std::int64_t r0 = bound((box.x - reach - kXMin) / kCell, kCellsX);
  const std::int64_t r1 = bound((box.x + reach - kXMin) / kCell, kCellsX);
  const std::int64_t c0 = bound((box.y - reach - kYMin) / kCell, kCellsY);
  const std::int64_t c1 = bound((box.y + reach - kYMin) / kCell, kCellsY);
  for (std::int64_t r = r0; r <= r1; ++r)
    for (std::int64_t c = c0; c <= c1; ++c) visit(r, c, to_local(box, cell_x(r, kCell), cell_y(c, kCell)));
}

}  // namespace

Local to_local(const MirageBox& box, double x, double y) {
  const double c = std::cos(box.yaw), s = std::sin(box.yaw), dx = x - box.x, dy = y - box.y;
  return {(c * dx + s * dy) / (box.length / 2.0), (c * dy - s * dx) / (box.width / 2.0)};
}

bool is_ignored(Local at) {
  return std::max(std::abs(at.along), std::abs(at.across)) <= 1.1;
}

Targets make_targets(std::span<const MirageBox> boxes, std::span<const MirageBox> ignored) {
  const std::int64_t cells = kCellsX * kCellsY;
  Targets targets;
  targets.positive = torch::zeros({cells});
  targets.negative = torch::ones({cells});
  targets.box = torch::zeros({6, cells});
  targets.box_weight = torch::zeros({cells});
  float* positive = targets.positive.data_ptr<float>();
  float* negative = targets.negative.data_ptr<float>();
  float* box_weight = targets.box_weight.data_ptr<float>();
  float* values = targets.box.data_ptr<float>();

  for (const MirageBox& box : ignored)
    for_each_cell(box, [&](std::int64_t r, std::int64_t c, Local at) {
      if (is_ignored(at)) negative[r * kCellsY + c] = 0;
    });
  std::vector<double> nearest(cells, 1e9);
  for (const MirageBox& box : boxes) {
    const auto row = static_cast<std::int64_t>(std::floor((box.x - kXMin) / kCell));
    const auto column = static_cast<std::int64_t>(std::floor((box.y - kYMin) / kCell));
    for_each_cell(box, [&](std::int64_t r, std::int64_t c, Local at) {
      const std::int64_t k = r * kCellsY + c;
      const double radius = std::hypot(at.along, at.across);
      const double heat = std::exp(-radius * radius / (2 * kHeatSigma * kHeatSigma));
      negative[k] = std::min(negative[k], static_cast<float>(std::pow(1 - heat, 4)));
      const bool centre = r == row && c == column;
      if (centre || radius < kPositiveRadius) positive[k] = 1;
      if (!(centre || radius < kBoxRadius) || radius >= nearest[k]) return;
      nearest[k] = radius;
      box_weight[k] = 1;
      values[k] = static_cast<float>(box.x - cell_x(r, kCell));
      values[cells + k] = static_cast<float>(box.y - cell_y(c, kCell));
      values[2 * cells + k] = static_cast<float>(std::log(box.length / kMeanLength));
      values[3 * cells + k] = static_cast<float>(std::log(box.width / kMeanWidth));
      values[4 * cells + k] = std::sin(2 * box.yaw);
      values[5 * cells + k] = std::cos(2 * box.yaw);
    });
  }
  targets.positives = targets.positive.sum().item<double>();
  targets.boxed = targets.box_weight.sum().item<double>();
  return targets;
}

LossTerms sum(const LossTerms& a, const LossTerms& b) {
  return {a.total + b.total, a.score + b.score, a.box + b.box};
}

LossTerms detection_loss(const Tensor& output, const Targets& targets, double positives, double boxed) {
  const Tensor logit = output.select(0, kLogit).reshape({-1});
  const Tensor score = torch::sigmoid(logit);
  // log p = −softplus(−x) and log(1 − p) = −softplus(x): no overflow at any logit.
  const Tensor miss = targets.positive * (1 - score).square() * torch::softplus(-logit);
  const Tensor alarm = (1 - targets.positive) * targets.negative * score.square() * torch::softplus(logit);
  const Tensor score_loss = (miss + alarm).sum() / std::max(1.0, positives);

  const Tensor error = (output.narrow(0, kDx, 6).reshape({6, -1}) - targets.box) * targets.box_weight;
  const Tensor size = error.abs();
  constexpr double beta = 0.1;
  const Tensor smooth = torch::where(size < beta, size.square() / (2 * beta), size - beta / 2);
  const Tensor box_loss = smooth.sum() / std::max(1.0, boxed);
  return {score_loss + kBoxWeight * box_loss, score_loss.item<double>(), box_loss.item<double>()};
}

MirageBox decode_box(std::int64_t cell, const std::array<float, 6>& values) {
  MirageBox box;
  box.x = static_cast<float>(cell_x(cell / kCellsY, kCell)) + values[0];
  box.y = static_cast<float>(cell_y(cell % kCellsY, kCell)) + values[1];
  // A wild logarithm must not become an infinite box.
  box.length = static_cast<float>(kMeanLength) * std::exp(std::clamp(values[2], -3.f, 3.f));
  box.width = static_cast<float>(kMeanWidth) * std::exp(std::clamp(values[3], -3.f, 3.f));
  box.yaw = 0.5f * std::atan2(values[4], values[5]);
  return box;
}

}  // namespace mirage::fusion
