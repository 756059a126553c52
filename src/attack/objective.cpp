#include "attack/objective.h"

#include <algorithm>
#include <cmath>

namespace mirage {

double softplus(double x) {
  return std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x)));
}

ObjectiveValue objective(std::span<const Proposal> proposals, const HostTruth& truth,
                         const ObjectiveSettings& settings) {
  check_proposals(proposals);
  ObjectiveValue value;
  value.d_logits.assign(proposals.size(), 0.0);
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const Proposal& proposal = proposals[i];
    const double score = proposal.score();  // the derivative of softplus
    if (score <= settings.relevant_score) continue;
    if (const double overlap = truth.host_iou(proposal); overlap > 0) {
      value.hide += overlap * softplus(proposal.logit);
      value.d_logits[i] = overlap * score;
    } else if (truth.label_iou(proposal) == 0) {
      value.false_positive -= settings.lambda_fp * softplus(proposal.logit);
      value.d_logits[i] = -settings.lambda_fp * score;
    }
  }
  return value;
}

}  // namespace mirage
