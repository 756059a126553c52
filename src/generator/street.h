// Lays out a street around the ego vehicle.
#pragma once

#include <cstdint>

#include "generator/placed.h"

namespace mirage::generator {

/// Whether the surface is something that lies on the roof of `placed`: part of the thing, but not of its
/// boxes.
bool on_roof(const Surface& surface, const Placed& placed);

/// `height`: of the `velo` origin over the road (m). `behind`: how much of the street lies behind the car
/// (m; 0: its first metres). Deterministic by (seed, index, look, behind).
Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look = Look::european,
                   double behind = 0);

// A street that lasts some seconds: what stands in it, the car's own way along it, and what drives. Ours is
// the right one of two lanes. A car ahead brakes (and so do we, a second later), one overtakes us, one or
// more come towards us, one crosses, and others keep their lanes. Nothing meets anything.
//
// The world is the car's `velo` at time 0, upright.

/// `height`: of the `velo` origin over the road (m). Deterministic by (seed, index, look, seconds).
MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds);

}  // namespace mirage::generator
