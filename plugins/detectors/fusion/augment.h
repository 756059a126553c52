// A training picture mirrored, made larger or smaller, with what is known of it moved along.
#pragma once

#include <torch/torch.h>

#include <cstdint>
#include <vector>

#include "detection/detector_abi3.h"
#include "network.h"

namespace mirage::fusion {

/// A picture and what a camera network is taught of it.
struct LabelledPicture {
  torch::Tensor image;                           ///< H × W × 3
  std::vector<MiragePictureBox> boxes, ignored;  ///< pixels; must be found, and give no loss
  std::vector<std::uint8_t> vehicle_mask;        ///< H × W; empty: unknown
};

/// What a sample says of its picture (`image`: that picture, or undefined).
LabelledPicture labelled_picture(const MirageSample& sample, const torch::Tensor& image);

/// Mirrored in one of two cases, and scaled by 0.7 to 1.4 (even in the logarithm). One that became larger is
/// cut to H × W at a random place, one that became smaller is smaller. A box is cut at the border; one that
/// loses more than half of its area there, or falls below 12 pixels of height, is ignored, and one that loses
/// all of it is gone. Depends on (seed, index) only. For networks that read pictures alone: no calibration
/// follows.
LabelledPicture augmented_picture(const LabelledPicture& labelled, std::uint64_t seed, std::uint64_t index);

// What training changes about a sample on the plugin's side. (The host flips, turns and scales.)

/// Thins the points by up to 40 % and shakes them by up to 2 cm; with `picture`, changes its exposure, colour
/// cast and contrast and adds a little noise. (The picture is never left out: that taught detectors to do
/// without.) Depends on (seed, index) only.
SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index, bool picture);

}  // namespace mirage::fusion
