#include "attack/objective.h"

#include <algorithm>
#include <cmath>

#include "base/sizes.h"

namespace mirage {
namespace {

/// Indices of the `most` background proposals with the largest logits, in falling order.
std::vector<std::size_t> top_background(std::span<const Detection> proposals, const HostTruth& truth,
                                        std::span<const Detection> clean, std::size_t most) {
  std::vector<std::size_t> heap(proposals.size()), top;
  for (std::size_t i = 0; i < heap.size(); ++i) heap[i] = i;
  const auto below = [&](std::size_t a, std::size_t b) {
    return proposals[a].logit < proposals[b].logit || (proposals[a].logit == proposals[b].logit && a > b);
  };
  std::make_heap(heap.begin(), heap.end(), below);
  while (!heap.empty() && top.size() < most) {
    std::pop_heap(heap.begin(), heap.end(), below);
    const Detection& proposal = proposals[heap.back()];
    if (truth.host_iou(proposal) == 0 && truth.label_iou(proposal) == 0 && !truth.in_dont_care(proposal) &&
        std::ranges::none_of(
            clean, [&](const Detection& seen) { return truth.matching().overlap(proposal, seen) > 0; }))
      top.push_back(heap.back());
    heap.pop_back();
  }
  return top;
}

}  // namespace

double softplus(double x) {
  return std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x)));
}

ObjectiveValue objective(std::span<const Detection> proposals, const HostTruth& truth,
                         const ObjectiveSettings& settings, std::span<const Detection> clean) {
  check_proposals(proposals, truth.matching());
  ObjectiveValue value;
  value.d_logits.assign(proposals.size(), 0.0);
  const auto reward = [&](std::size_t i) {
    value.false_positive -= settings.lambda_fp * softplus(proposals[i].logit);
    value.d_logits[i] = -settings.lambda_fp * proposals[i].score();
  };
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const Detection& proposal = proposals[i];
    const double score = proposal.score();  // the derivative of softplus
    if (score <= settings.relevant_score) continue;
    if (const double overlap = truth.host_iou(proposal); overlap > 0) {
      if (!settings.hides) continue;
      value.hide += overlap * softplus(proposal.logit);
      value.d_logits[i] = overlap * score;
    } else if (settings.fp_top_k == 0 && truth.label_iou(proposal) == 0) {
      reward(i);
    }
  }
  if (settings.fp_top_k > 0)
    for (const std::size_t i : top_background(proposals, truth, clean, as_size(settings.fp_top_k))) reward(i);
  return value;
}

}  // namespace mirage
