// The LiDAR's backbone as a plan.
#pragma once

#include <array>

#include "local_pass.h"
#include "network.h"

namespace mirage::fusion {

/// Numbers of its layers.
struct BackbonePlan {
  Plan plan;
  int voxels = 0;  ///< the input: soft_voxels, and painted_voxels behind them where the network paints
  std::array<int, kGrids.size()> added = {-1, -1, -1, -1};  ///< inputs: what continuous fusion adds
  int bev = -1;                                             ///< what the head reads, for a second stage
  int output = 0;                                           ///< kOutputs × 140 × 160
};

/// Folds the network's norms.
BackbonePlan backbone_plan(NetworkImpl& network, bool bfloat16 = false);

}  // namespace mirage::fusion
