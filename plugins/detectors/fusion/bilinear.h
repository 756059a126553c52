// Features of a map at scattered places, with the exact derivative.
#pragma once

#include "torch_headers.h"

namespace mirage::fusion {

/// map: 1 × C × H × W; at: N × 2, (column, row) with (0, 0) the centre of the first cell; both on the CPU,
/// float or double. Result: N × C, bilinear, the border's values outside (and no slope there). Differentiable
/// in both.
torch::Tensor bilinear(const torch::Tensor& map, const torch::Tensor& at);

/// Where pixels lie in a map with one place for each stride × stride of them, as bilinear() counts.
torch::Tensor places_in_map(const torch::Tensor& pixels, int stride);

}  // namespace mirage::fusion
