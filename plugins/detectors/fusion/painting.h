// Early fusion: the camera network's evidence painted on the returns (Vora et al., PointPainting, CVPR 2020).
#pragma once

#include "region.h"
#include "torch_headers.h"
#include "window.h"

namespace mirage::fusion {

struct SensorTensors;

/// Channels that painting adds to the voxels: how much of a column of 0.25 × 0.25 m shows vehicles, and how
/// much shows something else.
inline constexpr int kPaintedChannels = 2;

/// 1 × 2 × 280 × 320. Each return reads the probability e of "shows a vehicle" at its pixel from
/// input.camera's mask and spreads e and 1 − e over the 4 columns around it with bilinear weights w:
/// Σ w e / (1 + Σ w) and Σ w (1 − e) / (1 + Σ w). Returns that the camera does not see (outside the picture,
/// nearer than 0.5 m) are left out. All zero without a picture. Differentiable in mask and points, where a
/// return's evidence also moves with its pixel. Outside `within` the result is not complete.
torch::Tensor painted_voxels(const SensorTensors& input, const Window& within = {0, 0, kVoxelsX, kVoxelsY});

}  // namespace mirage::fusion
