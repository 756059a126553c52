#include "loss.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "base/sizes.h"
#include "region.h"
#include "sensor_tensors.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kPositiveRadius = 0.4;  // of the half-extents
constexpr double kBoxRadius = 0.7;       // the box term also trains the cells around the positive ones
constexpr double kHeatSigma = 0.45;
constexpr double kBoxWeight = 2.0;  // weight of the box term

/// A place in a box's frame, in half-extents.
struct Local {
  double along, across;
};

Local to_local(const MirageBox& box, double x, double y) {
  const double c = std::cos(box.yaw), s = std::sin(box.yaw), dx = x - box.x, dy = y - box.y;
  return {(c * dx + s * dy) / (box.length / 2.0), (c * dy - s * dx) / (box.width / 2.0)};
}

/// Whether that place in an ignored box's frame gives no background loss.
bool is_ignored(Local at) {
  return std::max(std::abs(at.along), std::abs(at.across)) <= 1.1;
}

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

constexpr double kCentreReach = 2.5;  // strides
constexpr double kIouCost = 3, kOutsideCost = 1e5;
constexpr std::size_t kBestIous = 10;
constexpr double kRectangleWeight = 5, kMaskWeight = 4;

bool holds(const MiragePictureBox& box, float x, float y) {
  return x > box.left && x < box.right && y > box.top && y < box.bottom;
}

double overlap(const MiragePictureBox& a, const float* b) {
  const double width = std::min(a.right, b[2]) - std::max(a.left, b[0]);
  const double height = std::min(a.bottom, b[3]) - std::max(a.top, b[1]);
  if (!(width > 0 && height > 0)) return 0;
  const double both = width * height;
  const double area_a = double{a.right - a.left} * (a.bottom - a.top),
               area_b = double{b[2] - b[0]} * (b[3] - b[1]);
  return both / (area_a + area_b - both);
}

/// −t log p − (1 − t) log(1 − p), without overflow.
Tensor cross_entropy(const Tensor& logit, const Tensor& target) {
  return torch::softplus(logit) - target * logit;
}

/// Smooth L1 of absolute errors: quadratic below `from`, with slope 1 beyond.
Tensor smooth_l1(const Tensor& size, double from) {
  return torch::where(size < from, size.square() / (2 * from), size - from / 2);
}

double log_score(double logit) {
  return -(std::max(-logit, 0.0) + std::log1p(std::exp(-std::abs(logit))));
}

/// Share of each place's 4 × 4 pixels that show a vehicle; −1 beyond the picture.
Tensor mask_target(const std::uint8_t* mask, std::int64_t height, std::int64_t width, const Tensor& like) {
  const Tensor all = torch::from_blob(const_cast<std::uint8_t*>(mask), {1, 1, height, width}, torch::kByte)
                         .to(torch::kFloat);
  const std::int64_t down = like.size(2) * kMaskStride - height, right = like.size(3) * kMaskStride - width;
  const auto spread = [&](const Tensor& x) {
    return torch::avg_pool2d(
        torch::nn::functional::pad(x, torch::nn::functional::PadFuncOptions({0, right, 0, down})),
        kMaskStride);
  };
  const Tensor inside = spread(torch::ones_like(all));
  return torch::where(inside > 0.5, spread(all) / inside.clamp_min(0.5), -torch::ones_like(inside));
}

constexpr double kScoredFrom = 0.3, kScoredFull = 0.8;  // of a new box, where its score's target rises
constexpr double kOnLabel = 0.5;                        // of an old box that learns to move
constexpr double kChangeWeight = 1, kSmoothBelow = 0.3;

/// The change from `from` to `to`, in kChangeUnits; directions are equal modulo half a turn.
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
      if (!(centre || radius < kBoxRadius) || radius >= nearest[as_size(k)]) return;
      nearest[as_size(k)] = radius;
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
  const Tensor box_loss = smooth_l1(error.abs(), 0.1).sum() / std::max(1.0, boxed);
  return {score_loss + kBoxWeight * box_loss, score_loss.item<double>(), box_loss.item<double>()};
}

MirageBox decode_box(const float* output, std::int64_t cell) {
  const auto value = [&](Output channel) { return output[channel * kCellsX * kCellsY + cell]; };
  MirageBox box;
  box.x = static_cast<float>(cell_x(cell / kCellsY, kCell)) + value(kDx);
  box.y = static_cast<float>(cell_y(cell % kCellsY, kCell)) + value(kDy);
  // A wild logarithm must not become an infinite box.
  box.length = static_cast<float>(kMeanLength) * std::exp(std::clamp(value(kLogLength), -3.f, 3.f));
  box.width = static_cast<float>(kMeanWidth) * std::exp(std::clamp(value(kLogWidth), -3.f, 3.f));
  box.yaw = 0.5f * std::atan2(value(kSin2Yaw), value(kCos2Yaw));
  return box;
}

Tensor row_iou(const Tensor& a, const Tensor& b) {
  const Tensor low = torch::max(a.narrow(1, 0, 2), b.narrow(1, 0, 2)),
               high = torch::min(a.narrow(1, 2, 2), b.narrow(1, 2, 2));
  const auto area = [](const Tensor& from, const Tensor& to) { return (to - from).clamp_min(0).prod(1); };
  const Tensor both = area(low, high);
  const Tensor sum =
      area(a.narrow(1, 0, 2), a.narrow(1, 2, 2)) + area(b.narrow(1, 0, 2), b.narrow(1, 2, 2)) - both;
  return both / sum.clamp_min(1e-6);
}

PictureMatch match(std::span<const Place> places, std::span<const float> predicted_boxes,
                   std::span<const float> predicted_logits, std::span<const MiragePictureBox> boxes,
                   std::span<const MiragePictureBox> ignored, std::int64_t height, std::int64_t width) {
  struct Candidate {
    std::int64_t place;
    double cost, iou;
  };
  std::vector<double> cheapest(places.size(), 1e18);
  std::vector<std::int64_t> owner(places.size(), -1);
  for (std::size_t b = 0; b < boxes.size(); ++b) {
    const MiragePictureBox& box = boxes[b];
    const float x = (box.left + box.right) / 2, y = (box.top + box.bottom) / 2;
    std::vector<Candidate> candidates;
    for (std::size_t p = 0; p < places.size(); ++p) {
      const Place& place = places[p];
      const bool inside = holds(box, place.x, place.y);
      const bool central =
          std::max(std::abs(place.x - x), std::abs(place.y - y)) < kCentreReach * place.stride;
      if (!inside && !central) continue;
      const double iou = overlap(box, &predicted_boxes[4 * p]);
      candidates.push_back({static_cast<std::int64_t>(p),
                            -log_score(predicted_logits[p]) - kIouCost * std::log(iou + 1e-8) +
                                (inside && central ? 0 : kOutsideCost),
                            iou});
    }
    if (candidates.empty()) continue;
    std::vector<double> ious;
    for (const Candidate& candidate : candidates) ious.push_back(candidate.iou);
    const std::size_t best = std::min(kBestIous, ious.size());
    std::partial_sort(ious.begin(), ious.begin() + static_cast<std::ptrdiff_t>(best), ious.end(),
                      std::greater<>());
    const double sum = std::accumulate(ious.begin(), ious.begin() + static_cast<std::ptrdiff_t>(best), 0.0);
    const std::size_t count = std::clamp<std::size_t>(static_cast<std::size_t>(sum), 1, candidates.size());
    std::partial_sort(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(count),
                      candidates.end(),
                      [](const Candidate& a, const Candidate& c) { return a.cost < c.cost; });
    for (std::size_t k = 0; k < count; ++k) {
      const auto [place, cost, iou] = candidates[k];
      if (cost >= cheapest[as_size(place)]) continue;
      cheapest[as_size(place)] = cost;
      owner[as_size(place)] = static_cast<std::int64_t>(b);
    }
  }
  PictureMatch matched;
  for (std::size_t p = 0; p < places.size(); ++p) {
    const Place& place = places[p];
    if (owner[p] >= 0) {
      matched.places.push_back(static_cast<std::int64_t>(p));
      matched.boxes.push_back(owner[p]);
    } else if (place.x > static_cast<float>(width) || place.y > static_cast<float>(height) ||
               std::any_of(ignored.begin(), ignored.end(),
                           [&](const MiragePictureBox& box) { return holds(box, place.x, place.y); })) {
      matched.silent.push_back(static_cast<std::int64_t>(p));
    }
  }
  return matched;
}

LossTerms picture_loss(const CameraOutput& output, std::span<const MiragePictureBox> boxes,
                       std::span<const MiragePictureBox> ignored, const std::uint8_t* vehicle_mask,
                       std::int64_t height, std::int64_t width) {
  const std::vector<Place> places = places_of(height, width);
  const Tensor now = output.boxes.detach().contiguous(), logits = output.logits.detach().contiguous();
  const PictureMatch matched =
      match(places, {now.data_ptr<float>(), 4 * places.size()}, {logits.data_ptr<float>(), places.size()},
            boxes, ignored, height, width);
  const double answering = std::max<double>(1, static_cast<double>(matched.places.size()));
  Tensor target = torch::zeros_like(logits), weight = torch::ones_like(logits);
  if (!matched.silent.empty()) weight.index_fill_(0, torch::tensor(matched.silent), 0);
  Tensor box_loss = torch::zeros({});
  if (!matched.places.empty()) {
    const Tensor matched_places = torch::tensor(matched.places);
    std::vector<float> wanted;
    for (const std::int64_t b : matched.boxes)
      wanted.insert(wanted.end(), {boxes[as_size(b)].left, boxes[as_size(b)].top, boxes[as_size(b)].right,
                                   boxes[as_size(b)].bottom});
    const Tensor iou =
        row_iou(output.boxes.index_select(0, matched_places), torch::tensor(wanted).view({-1, 4}));
    target.index_copy_(0, matched_places, iou.detach());
    box_loss = (1 - iou.square()).sum() / answering;
  }
  const Tensor score_loss = (cross_entropy(output.logits, target) * weight).sum() / answering;
  Tensor mask_loss = torch::zeros({});
  if (vehicle_mask) {
    const Tensor wanted = mask_target(vehicle_mask, height, width, output.mask);
    const Tensor inside = wanted >= 0, share = wanted.clamp_min(0);
    const Tensor error = (torch::sigmoid(output.mask) - share).abs();
    mask_loss = (cross_entropy(output.mask, share) * error.square() * inside).sum() /
                (share * inside).sum().clamp_min(100);
  }
  const Tensor total = score_loss + kRectangleWeight * box_loss + kMaskWeight * mask_loss;
  return {total, (score_loss + mask_loss).item<double>(), box_loss.item<double>()};
}

LossTerms region_loss(const Regions& regions, std::span<const MirageBox> boxes,
                      std::span<const MirageBox> ignored) {
  const auto count = static_cast<std::int64_t>(regions.cells.size());
  if (count == 0) return {torch::zeros({}), 0, 0};
  const Tensor before = regions.boxes.detach().to(torch::kFloat).contiguous(),
               after = regions.refined().detach().to(torch::kFloat).contiguous();
  Tensor target = torch::zeros({count}), weight = torch::ones({count}),
         change = torch::zeros({count, kBoxParts}), boxed = torch::zeros({count, 1});
  for (std::int64_t k = 0; k < count; ++k) {
    const BevBox old = bev_box(before.data_ptr<float>() + kBoxParts * k),
                 now = bev_box(after.data_ptr<float>() + kBoxParts * k);
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
  const Tensor score_loss = (weight * cross_entropy(logits, target)).sum() / weight.sum().clamp_min(1);
  const Tensor size = (regions.change.to(torch::kFloat) - change).abs() * boxed;
  const Tensor box_loss = smooth_l1(size, kSmoothBelow).sum() / (kBoxParts * boxed.sum().clamp_min(1));
  return {score_loss + kChangeWeight * box_loss, score_loss.item<double>(), box_loss.item<double>()};
}

}  // namespace mirage::fusion
