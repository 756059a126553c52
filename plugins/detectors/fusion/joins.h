// Early fusion: the camera network's evidence painted on the returns (Vora et al., PointPainting, CVPR 2020).
#pragma once

#include <torch/torch.h>

#include <cstdint>
#include <span>
#include <vector>

#include "region.h"
#include "sampling.h"
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
torch::Tensor painted_voxels(const SensorTensors& input, const Window& within = kGridWindow);

// Fusion that trusts a pixel only as far as its depth agrees with the point's: the defence against features
// that reach a point from an object in front of it in the picture (Mirage's own; the paper leaves it open).
//
// A point's image feature is gathered around its pixel. If LiDAR returns there are much nearer to the camera
// than the point, the pixels show that nearer object, and their feature is not the point's: an adversary on a
// roof speaks for the street behind it. The feature is multiplied by
//     g = sigmoid((r − log(z / z_front)) / s),  r = log 1.4, s = 0.05
// with the depth z of the point and z_front of the nearest return around its pixel. The ground's own depths
// differ by less than the ratio within such a window out to 40 m. A front object without a LiDAR return stays
// ungated.

/// For each chosen point the point of least depth among those that the camera sees within the 3 × 3 image
/// cells of 8 pixels around its own (itself where none is nearer; of equals the first). Discrete: no
/// gradient.
std::vector<std::int64_t> nearest_before(std::span<const float> points, const Projection& projection,
                                         int width, int height, std::span<const std::int64_t> indices);

/// g for depths z and z_front (n each, m, positive); differentiable in both.
torch::Tensor depth_gate(const torch::Tensor& depth, const torch::Tensor& front);

// Late fusion: the LiDAR's proposals joined with the camera's boxes (after Pang et al., CLOCs, IROS 2020).

struct LateJoinImpl : torch::nn::Module {
  LateJoinImpl();
  /// `output`: kOutputs × 140 × 160 of the backbone. The result has a new logit where the backbone's is above
  /// −4 (of the 400 highest). A small network scores every pair of the proposal and one of the 200 best
  /// picture boxes that overlap it in the picture (IoU, the box's logit, the proposal's logit, distance). The
  /// highest score counts; a proposal without a pair is paired with nothing. Lower logits stay. The
  /// proposal's box in the picture is that of a car's box on the lowest return nearby. Differentiable in both
  /// logits; the choice of pairs and their IoU carry no gradient.
  torch::Tensor forward(const torch::Tensor& output, const SensorTensors& input);
  torch::nn::Linear first{nullptr}, second{nullptr}, third{nullptr}, last{nullptr};
};
TORCH_MODULE(LateJoin);

}  // namespace mirage::fusion
