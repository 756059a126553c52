// The proposals that a second look is given to.
#pragma once

#include <cstdint>
#include <vector>

#include "torch_headers.h"

namespace mirage::fusion {

/// The places of the highest of `logits` above `least`, `most` at most, in the order of places (of equal ones
/// the first count). A discrete choice, made in float.
std::vector<std::int64_t> highest(const torch::Tensor& logits, float least, std::size_t most);

}  // namespace mirage::fusion
