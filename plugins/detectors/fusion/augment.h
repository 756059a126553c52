// A training picture mirrored and scaled, with its labels.
#pragma once

#include <torch/torch.h>

#include <cstdint>
#include <vector>

#include "detection/detector_abi3.h"
#include "network.h"

namespace mirage::fusion {

/// A picture and its labels for a camera network.
struct LabelledPicture {
  torch::Tensor image;                           ///< H × W × 3
  std::vector<MiragePictureBox> boxes, ignored;  ///< pixels; must be found, and give no loss
  std::vector<std::uint8_t> vehicle_mask;        ///< H × W; empty: unknown
};

/// The labels of a sample's picture (`image`: that picture, or undefined).
LabelledPicture labelled_picture(const MirageSample& sample, const torch::Tensor& image);

/// Mirrored with probability 1/2, and scaled by 0.7 to 1.4 (log-uniform). A larger picture is cut to H × W at
/// a random place; a smaller one stays smaller. A box is clipped at the border; if it loses more than half of
/// its area there, or falls below 12 pixels of height, it is ignored, and without any area left it is
/// dropped. Depends on (seed, index) only. For networks that read pictures alone: no calibration follows.
LabelledPicture augmented_picture(const LabelledPicture& labelled, std::uint64_t seed, std::uint64_t index);

// The augmentation on the plugin's side. (The host flips, turns and scales.)

/// Thins the points by up to 40 % and shakes them by up to 2 cm; with `picture`, changes its exposure, colour
/// cast and contrast and adds a little noise. (The picture is never left out: that taught detectors to ignore
/// it.) Depends on (seed, index) only.
SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index, bool picture);

}  // namespace mirage::fusion
