// What the network takes, and the channels of what it gives.
#pragma once

#include <torch/torch.h>

#include "camera.h"
#include "detection/detector_abi3.h"
#include "sampling.h"

namespace mirage::fusion {

/// Channels of the output, one proposal a cell.
enum Output { kLogit, kDx, kDy, kLogLength, kLogWidth, kSin2Yaw, kCos2Yaw, kOutputs };

/// Pixels a side of a place of the image branch's map.
inline constexpr int kImageStride = 8;

/// On the CPU, whatever device the network is on.
struct SensorTensors {
  torch::Tensor image;   ///< H × W × 3 scene-linear, or undefined: LiDAR alone
  torch::Tensor points;  ///< N × 4
  Projection projection{};
  torch::Tensor watched = {};  ///< K × 4: further points, whose mass is `masses` (K, zero) instead of one;
                               ///< undefined: none. They feed voxels and paint, and no cell of fusion
  torch::Tensor masses = {};
  CameraOutput camera = {};  ///< what the camera network says of the picture, where that is known already
};

// The host's sensor data as tensors.

/// Views of the host's memory, which lives until its next call. Without a picture where there is none, or
/// none is wanted.
SensorTensors view_input(const MirageSensorInput& input, bool with_image);
/// Own copies: the host may free its memory while a graph lives on.
SensorTensors copy_input(const MirageSensorInput& input, bool with_image);

}  // namespace mirage::fusion
