#include "camera_loss.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace mirage::fusion {
namespace {

using torch::Tensor;

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

}  // namespace

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
      if (cost >= cheapest[place]) continue;
      cheapest[place] = cost;
      owner[place] = static_cast<std::int64_t>(b);
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
      wanted.insert(wanted.end(), {boxes[b].left, boxes[b].top, boxes[b].right, boxes[b].bottom});
    const Tensor iou =
        row_iou(output.boxes.index_select(0, matched_places), torch::tensor(wanted).view({-1, 4}));
    target.index_copy_(0, matched_places, iou.detach());
    box_loss = (1 - iou.square()).sum() / answering;
  }
  // −t log p − (1 − t) log(1 − p), without overflow.
  const auto cross_entropy = [](const Tensor& logit, const Tensor& wanted) {
    return torch::softplus(logit) - wanted * logit;
  };
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

}  // namespace mirage::fusion
