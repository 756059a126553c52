// LiDAR points to a soft occupancy grid, with its exact derivative.
#pragma once

#include "torch_headers.h"
#include "window.h"

namespace mirage::fusion {

/// points: N × (x, y, z, …) float or double, `velo`, on the CPU. Each point spreads a unit of mass over the 8
/// voxels whose centres surround it, with tri-linear weights; what falls outside the grid is dropped, and so
/// are points that are not finite. Result: 1 × 18 × 280 × 320 (layers as channels; rows along x, columns
/// along y), channels-last. Differentiable in x, y and z; reflectance is not read, because sensors and
/// generated sweeps disagree about it. Bounded to [0, 1) by m / (1 + m), so that near, dense cars look like
/// far, thin ones.
torch::Tensor soft_voxels(const torch::Tensor& points);
/// The same with further points whose unit of mass is `masses` (K) instead, differentiable in these; their
/// places have no derivative. K × (x, y, z, …).
torch::Tensor soft_voxels(const torch::Tensor& points, const torch::Tensor& further,
                          const torch::Tensor& masses);
/// A window of the same (zero beyond the grid), of float points; no gradient.
torch::Tensor soft_voxels(const torch::Tensor& points, const Window& in);
/// Its VJP: d points (N × 4) from the gradient in the window's voxels.
torch::Tensor soft_voxels_vjp(const torch::Tensor& points, const Window& in, const torch::Tensor& voxels,
                              const torch::Tensor& gradient);
/// The derivative in the masses of further points, where these are 0: K.
torch::Tensor soft_voxels_masses(const torch::Tensor& further, const Window& in, const torch::Tensor& voxels,
                                 const torch::Tensor& gradient);
/// Adds the columns of voxels that a point reaches.
void add_voxels_of(const float* point, Dirty& dirty);

}  // namespace mirage::fusion
