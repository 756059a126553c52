// Lays out a street around the ego vehicle.
#pragma once

#include <cstdint>

#include "generator/look.h"
#include "generator/placed.h"

namespace mirage::generator {

/// Whether the surface is something that lies on the roof of `placed`: part of the thing, but not of its
/// boxes.
bool on_roof(const Surface& surface, const Placed& placed);

/// `height`: of the `velo` origin over the road (m). `behind`: how much of the street lies behind the car
/// (m; 0: its first metres). Deterministic by (seed, index, look, behind).
Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look = Look::european,
                   double behind = 0);

}  // namespace mirage::generator
