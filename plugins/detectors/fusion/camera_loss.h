// What the camera network is taught: boxes in the picture, and which pixels show vehicles.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "camera.h"
#include "detection/detector_abi3.h"
#include "loss.h"

namespace mirage::fusion {

/// Which places answer for which box.
struct PictureMatch {
  std::vector<std::int64_t> places, boxes;  ///< pairs; a place answers for one box at most
  std::vector<std::int64_t> silent;         ///< further places whose score is taught nothing
};

/// SimOTA (Ge et al., 2021): candidates of a box are the places inside it, or within 2.5 strides of its
/// centre; each costs −log score − 3 log IoU of what it says now (and much more unless it is both inside and
/// near the centre); the cheapest Σ (ten best IoUs) of them answer for the box. Silent: places whose centre
/// lies in an ignored box, and all whose centre lies beyond the picture.
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

}  // namespace mirage::fusion
