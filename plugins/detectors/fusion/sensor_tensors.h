// The network's input, and the channels of its output.
#pragma once

#include <torch/torch.h>

#include <algorithm>

#include "camera.h"
#include "detection/detector_abi3.h"
#include "geometry/box.h"
#include "sampling.h"

namespace mirage::fusion {

/// Channels of the output, one proposal a cell.
enum Output { kLogit, kDx, kDy, kLogLength, kLogWidth, kSin2Yaw, kCos2Yaw, kOutputs };

/// On the CPU, whatever device the network is on.
struct SensorTensors {
  torch::Tensor image;   ///< H × W × 3 scene-linear, or undefined: LiDAR alone
  torch::Tensor points;  ///< N × 4
  Projection projection{};
  torch::Tensor watched = {};  ///< K × 4: further points, whose mass is `masses` (K, zero) instead of one;
                               ///< undefined: none. They feed voxels and paint, and no cell of fusion
  torch::Tensor masses = {};
  CameraOutput camera = {};  ///< the camera network's output for the picture, if already known
};

// The host's sensor data as tensors.

/// Views of the host's memory, which lives until its next call. Without a picture if there is none or
/// !with_image.
inline SensorTensors view_input(const MirageSensorInput& input, bool with_image) {
  SensorTensors tensors;
  if (with_image && input.image && input.width > 0 && input.height > 0)
    tensors.image = torch::from_blob(const_cast<float*>(input.image), {input.height, input.width, 3});
  if (input.points && input.point_count > 0)
    tensors.points = torch::from_blob(const_cast<float*>(input.points), {input.point_count, 4});
  else
    tensors.points = torch::empty({0, 4});
  std::copy(std::begin(input.pixel_from_velo), std::end(input.pixel_from_velo), tensors.projection.begin());
  return tensors;
}
/// Own copies: the host may free its memory while a graph lives on.
inline SensorTensors copy_input(const MirageSensorInput& input, bool with_image) {
  SensorTensors tensors = view_input(input, with_image);
  if (tensors.image.defined()) tensors.image = tensors.image.clone();
  tensors.points = tensors.points.clone();
  return tensors;
}

inline BevBox bev_box(const MirageBox& b) {
  return {b.x, b.y, b.length, b.width, b.yaw};
}
/// b: x, y, length, width (m), yaw (rad).
inline BevBox bev_box(const float* b) {
  return {b[0], b[1], b[2], b[3], b[4]};
}

}  // namespace mirage::fusion
