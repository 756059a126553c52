// Fusion that trusts a pixel only as far as its depth agrees with the point's: the defence against features
// that reach a point from something that stands before it in the picture (Mirage's own; the paper leaves it
// open).
//
// A point's image feature is gathered around its pixel. If LiDAR returns there are much nearer to the camera
// than the point, the pixels show that nearer thing, and what they say is not about the point: an adversary
// on a roof speaks for the street behind it. The feature is multiplied by
//     g = sigmoid((r − log(z / z_front)) / s),  r = log 1.4, s = 0.05
// with the depth z of the point and z_front of the nearest return around its pixel. The ground's own depths
// differ by less than the ratio within such a window out to 40 m. What the LiDAR does not see (no return on
// the thing in front) stays ungated.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "nearest.h"
#include "torch_headers.h"

namespace mirage::fusion {

/// For each chosen point the point of least depth among those that the camera sees within the 3 × 3 image
/// cells of 8 pixels around its own (itself where none is nearer; of equals the first). Discrete: no
/// gradient.
std::vector<std::int64_t> nearest_before(std::span<const float> points, const Projection& projection,
                                         int width, int height, std::span<const std::int64_t> indices);

/// g for depths z and z_front (n each, m, positive); differentiable in both.
torch::Tensor depth_gate(const torch::Tensor& depth, const torch::Tensor& front);

}  // namespace mirage::fusion
