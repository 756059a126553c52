// Ground-truth boxes to per-cell targets, and the training loss.
#pragma once

#include <span>

#include "detection/detector_abi3.h"
#include "torch_headers.h"

namespace mirage::fusion {

/// A place in a box's frame, in half-extents.
struct Local {
  double along, across;
};
Local to_local(const MirageBox& box, double x, double y);
/// Whether what lies there in an ignored box's frame gives no background loss.
bool is_ignored(Local at);

/// Per-cell targets, each `cells` long (or 6 × cells): made once per sample.
struct Targets {
  torch::Tensor positive;    ///< 1 near a box's centre
  torch::Tensor negative;    ///< weight of the background term: (1 − heat)^4, 0 inside ignored boxes
  torch::Tensor box;         ///< 6 × cells: dx, dy (m), log l, log w, sin 2 yaw, cos 2 yaw
  torch::Tensor box_weight;  ///< 1 where the box term counts
  double positives = 0, boxed = 0;
};

/// A cell is positive inside the ellipse of 0.4 half-extents around a box's centre (at least the cell that
/// holds the centre). Elsewhere the background weight falls towards a centre as in CornerNet (Law & Deng,
/// ECCV 2018). Ignored boxes give no background term inside them.
Targets make_targets(std::span<const MirageBox> boxes, std::span<const MirageBox> ignored);

struct LossTerms {
  torch::Tensor total;
  double score = 0, box = 0;
};
LossTerms sum(const LossTerms& a, const LossTerms& b);

/// Focal loss (Lin et al., ICCV 2017; γ = 2) on the logit and smooth-L1 on the box terms, divided by the
/// batch's numbers of positive and boxed cells.
LossTerms detection_loss(const torch::Tensor& output, const Targets& targets, double positives, double boxed);

/// The box that the six regressed values of a cell mean.
MirageBox decode_box(std::int64_t cell, const std::array<float, 6>& values);

}  // namespace mirage::fusion
