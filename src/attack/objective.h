// The attack's objective on one host vehicle (src/README.md; Tu et al., CoRL 2021), in logits:
//     L = Σ_relevant IoU(b, b*) softplus(logit(b)) − λ_fp Σ_fp softplus(logit(b))
// because −log(1 − sigmoid(x)) = softplus(x). relevant: score > 0.1 and overlapping the host's box b* (in the
// picture: the box of the host with the larger IoU). fp: one of two rules:
//     fp_top_k = k > 0   the k proposals with the largest logits, whatever their score, that overlap neither
//                        ground truth, nor a DontCare region, nor a clean detection of the frame (an
//                        unlabelled car: FP ASR does not count it either). The paper's set has no threshold;
//                        its tail beyond k adds next to nothing to the gradient
//     fp_top_k = 0       score > 0.1 and no overlap with any ground truth: background cells below 10 % get no
//                        gradient
// If the placement's victim is a phantom (Victim), the first sum is left out. IoU weights and the choice of
// proposals are treated as constants: gradients go to the logits only.
#pragma once

#include <span>
#include <vector>

#include "attack/host_outcome.h"
#include "base/fields.h"

namespace mirage {

/// Thresholds and weights of the loss (Tu et al., CoRL 2021, section 3).
struct ObjectiveSettings {
  double relevant_score = 0.1;
  double lambda_fp = 1.0;
  double lambda_laplacian = 0.001;
  int fp_top_k = 50;  ///< k of the first rule above; 0: the second rule
  /// Whether the first sum counts; false for Victim::phantom, which seeks phantoms alone.
  bool hides = true;

  /// Proposals of at most this score are in neither sum.
  double least_score() const { return fp_top_k > 0 ? 0 : relevant_score; }
};
template <class Visitor, FieldsOf<ObjectiveSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "relevant_score", .range = kShare, .option = ""}, s.relevant_score);
  visit({.name = "lambda_fp", .help = "weight of the false-positive loss"}, s.lambda_fp);
  visit(
      {.name = "lambda_laplacian", .help = "weight of the Laplacian smoothness loss", .option = "lambda-lap"},
      s.lambda_laplacian);
  visit({.name = "fp_top_k",
         .help = "the false-positive loss takes the N background proposals with the largest logits. "
                 "0: all with a score over 0.1",
         .range = kNotNegative,
         .lacking = "0"},
        s.fp_top_k);
}

/// The loss of one host and its derivative.
struct ObjectiveValue {
  double hide = 0, false_positive = 0;  ///< the two sums (the second with its sign and λ_fp)
  std::vector<double> d_logits;         ///< one for each proposal
};

/// The loss over the proposals of one host's frame, and d loss / d logit of each. `clean`: detections in the
/// frame without an object (attack/evaluation.h, detections), used only by fp_top_k. Among equal logits the
/// earlier proposal comes first.
ObjectiveValue objective(std::span<const Detection> proposals, const HostTruth& truth,
                         const ObjectiveSettings& settings, std::span<const Detection> clean = {});

/// log(1 + exp(x)) without overflow.
double softplus(double x);

}  // namespace mirage
