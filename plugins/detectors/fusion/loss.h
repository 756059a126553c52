// Ground-truth boxes to per-cell targets, and the training loss.
#pragma once

#include <torch/torch.h>

#include <cstdint>
#include <span>
#include <vector>

#include "camera.h"
#include "detection/detector_abi3.h"
#include "second_stage.h"

namespace mirage::fusion {

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

/// The box that a cell's six regressed values encode. output: kOutputs × 140 × 160.
MirageBox decode_box(const float* output, std::int64_t cell);

// The camera network's targets: boxes in the picture, and pixels that show vehicles.

/// Which places answer for which box.
struct PictureMatch {
  std::vector<std::int64_t> places, boxes;  ///< pairs; a place answers for one box at most
  std::vector<std::int64_t> silent;         ///< further places without a loss on the score
};

/// SimOTA (Ge et al., 2021): candidates of a box are the places inside it, or within 2.5 strides of its
/// centre; each costs −log score − 3 log IoU of its current prediction (and much more unless it is both
/// inside and near the centre); the cheapest Σ (ten best IoUs) of them answer for the box. Silent: places
/// whose centre lies in an ignored box, and all whose centre lies beyond the picture.
PictureMatch match(std::span<const Place> places, std::span<const float> predicted_boxes,
                   std::span<const float> predicted_logits, std::span<const MiragePictureBox> boxes,
                   std::span<const MiragePictureBox> ignored, std::int64_t height, std::int64_t width);

/// Binary cross-entropy of every score (its target for an answering place: the IoU it reaches), 5 (1 − IoU²)
/// of every answering box, both over their number; and, where a mask is given, the focal-weighted
/// cross-entropy of the mask's places against the share of their 4 × 4 pixels that show a vehicle.
/// `vehicle_mask`: height × width of 0 or 1, or nullptr.
LossTerms picture_loss(const CameraOutput& output, std::span<const MiragePictureBox> boxes,
                       std::span<const MiragePictureBox> ignored, const std::uint8_t* vehicle_mask,
                       std::int64_t height, std::int64_t width);

/// IoU of each row of `a` with the same row of `b` (both n × 4); differentiable.
torch::Tensor row_iou(const torch::Tensor& a, const torch::Tensor& b);

// The second stage's targets.

/// Score: cross entropy. Its target rises from 0 to 1 between an IoU of 0.3 and 0.8 of the region's new box
/// with the label that its old one overlaps most, so that a car's best box comes first (Jiang et al.,
/// IoU-Net, ECCV 2018). Box: smooth L1 of the change, in kChangeUnits, where the old box's IoU is 0.5 or
/// more. Both are means over the regions that count; those within an ignored box that overlap no label by 0.3
/// do not.
LossTerms region_loss(const Regions& regions, std::span<const MirageBox> boxes,
                      std::span<const MirageBox> ignored);

}  // namespace mirage::fusion
