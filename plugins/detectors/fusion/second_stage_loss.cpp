#include "second_stage_loss.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "geometry/box.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kScoredFrom = 0.3, kScoredFull = 0.8;  // of a new box, where its score's target rises
constexpr double kOnLabel = 0.5;                        // of an old box that learns to move
constexpr double kChangeWeight = 1, kSmoothBelow = 0.3;

BevBox bev_box(const float* b) {
  return {b[0], b[1], b[2], b[3], b[4]};
}

BevBox bev_box(const MirageBox& b) {
  return {b.x, b.y, b.length, b.width, b.yaw};
}

/// What turns `from` into `to`, in kChangeUnits; directions are the same half a turn on.
std::array<float, kBoxParts> change_between(const BevBox& from, const BevBox& to) {
  const double c = std::cos(from.yaw), s = std::sin(from.yaw), dx = to.x - from.x, dy = to.y - from.y;
  const double along = c * dx + s * dy, across = c * dy - s * dx;
  const double turn = std::remainder(to.yaw - from.yaw, std::numbers::pi);
  const std::array<double, kBoxParts> change = {along, across, std::log(to.length / from.length),
                                                std::log(to.width / from.width), turn};
  std::array<float, kBoxParts> counted{};
  for (std::size_t k = 0; k < counted.size(); ++k)
    counted[k] = static_cast<float>(change[k] / kChangeUnits[k]);
  return counted;
}

}  // namespace

LossTerms region_loss(const Regions& regions, std::span<const MirageBox> boxes,
                      std::span<const MirageBox> ignored) {
  const auto count = static_cast<std::int64_t>(regions.cells.size());
  if (count == 0) return {torch::zeros({}), 0, 0};
  const Tensor before = regions.boxes.detach().to(torch::kFloat).contiguous(),
               after = regions.refined().detach().to(torch::kFloat).contiguous();
  Tensor target = torch::zeros({count}), weight = torch::ones({count}),
         change = torch::zeros({count, kBoxParts}), boxed = torch::zeros({count, 1});
  for (std::int64_t k = 0; k < count; ++k) {
    const BevBox old = bev_box(before.data_ptr<float>() + 5 * k),
                 now = bev_box(after.data_ptr<float>() + 5 * k);
    const MirageBox* best = nullptr;
    double most = 0;
    for (const MirageBox& box : boxes)
      if (const double overlap = iou(old, bev_box(box)); overlap > most) most = overlap, best = &box;
    if (best) {
      const double found = iou(now, bev_box(*best));
      target[k] = std::clamp((found - kScoredFrom) / (kScoredFull - kScoredFrom), 0.0, 1.0);
    }
    if (most >= kOnLabel) {
      const auto wanted = change_between(old, bev_box(*best));
      std::copy(wanted.begin(), wanted.end(), change.data_ptr<float>() + kBoxParts * k);
      boxed[k][0] = 1;
    } else if (most < kScoredFrom && std::any_of(ignored.begin(), ignored.end(), [&](const MirageBox& box) {
                 return is_ignored(to_local(box, old.x, old.y));
               })) {
      weight[k] = 0;
    }
  }
  const Tensor logits = regions.logits.to(torch::kFloat);
  const Tensor score_loss =
      (weight * (torch::softplus(logits) - target * logits)).sum() / weight.sum().clamp_min(1);
  const Tensor size = (regions.change.to(torch::kFloat) - change).abs() * boxed;
  const Tensor smooth =
      torch::where(size < kSmoothBelow, size.square() / (2 * kSmoothBelow), size - kSmoothBelow / 2);
  const Tensor box_loss = smooth.sum() / (kBoxParts * boxed.sum().clamp_min(1));
  return {score_loss + kChangeWeight * box_loss, score_loss.item<double>(), box_loss.item<double>()};
}

}  // namespace mirage::fusion
