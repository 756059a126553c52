// The LiDAR's backbone as a plan.
#pragma once

#include <array>

#include "camera.h"
#include "local_pass.h"
#include "network.h"

namespace mirage::fusion {

/// Numbers of its layers.
struct BackbonePlan {
  Plan plan;
  int voxels = 0;  ///< the input: soft_voxels, and painted_voxels behind them where the network paints
  std::array<int, kGrids.size()> added = {-1, -1, -1, -1};  ///< inputs: continuous fusion's terms
  int bev = -1;                                             ///< the head's input, for a second stage
  int output = 0;                                           ///< kOutputs × 140 × 160
};

/// Folds the network's norms.
BackbonePlan backbone_plan(NetworkImpl& network, bool bfloat16 = false);

// The camera network as a plan, and the picture's windows as its input.

/// Numbers of its layers.
struct CameraPlan {
  Plan plan;
  int picture_layer = 0;   ///< the input: focus() of the padded picture
  int features_layer = 0;  ///< CameraOutput::features
  int mask_layer = 0;      ///< CameraOutput::mask
  int fusion_layer = -1;   ///< continuous fusion's map: features, and the mask at their size
  std::array<int, 3> row_layers = {-1, -1, -1};  ///< of the heads, by scale
  std::int64_t height = 0, width = 0;            ///< of the picture
};

/// For pictures of a size. `boxes`: with the heads; `read`: with the map for continuous fusion. The maps of
/// the outputs named above are kept.
CameraPlan camera_plan(CameraNetImpl& network, std::int64_t height, std::int64_t width, bool boxes, bool read,
                       bool bfloat16 = false);

/// The plan's input over a window (zero beyond it, which the network's first convolution wants there).
/// picture: H × W × 3, of which the window's pixels are read. Differentiable in it.
torch::Tensor focused(const torch::Tensor& picture, const Window& at);

/// The heads' maps to one row a place, of all scales in turn: N × 6.
torch::Tensor head_rows(const std::array<torch::Tensor, 3>& maps);

}  // namespace mirage::fusion
