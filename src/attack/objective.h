// The attack's objective on one host vehicle (src/README.md; Tu et al., CoRL 2021), in logits:
//     L = Σ_relevant IoU(b, b*) softplus(logit(b)) − λ_fp Σ_fp softplus(logit(b))
// because −log(1 − sigmoid(x)) = softplus(x). relevant: score > 0.1 and overlapping the host's box b* (in the
// picture: one of its boxes, and that with the larger IoU is b*); fp: score > 0.1 and no overlap with any
// ground truth. IoU weights are constants: gradients go to the logits.
#pragma once

#include <span>
#include <vector>

#include "attack/host_truth.h"

namespace mirage {

/// Thresholds and weights of the loss (Tu et al., CoRL 2021, section 3).
struct ObjectiveSettings {
  double relevant_score = 0.1;
  double lambda_fp = 1.0;
  double lambda_laplacian = 0.001;
};

/// The loss of one host and its derivative.
struct ObjectiveValue {
  double hide = 0, false_positive = 0;  ///< the two sums (the second with its sign and λ_fp)
  std::vector<double> d_logits;         ///< one a proposal
};

/// The loss over the proposals of one host's frame, and d loss / d logit of each. Written in logits: log(1 −
/// sigmoid(x)) = −softplus(x).
ObjectiveValue objective(std::span<const Proposal> proposals, const HostTruth& truth,
                         const ObjectiveSettings& settings);

/// log(1 + exp(x)) without overflow.
double softplus(double x);

}  // namespace mirage
