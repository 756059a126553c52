// A street that lasts some seconds: what stands in it, the car's own way along it, and what drives. Ours is
// the right one of two lanes. A car ahead brakes (and so do we, a second later), one overtakes us, one or
// more come towards us, one crosses, and others keep their lanes. Nothing meets anything.
//
// The world is the car's `velo` at time 0, upright.
#pragma once

#include <cstdint>

#include "generator/look.h"
#include "generator/placed.h"

namespace mirage::generator {

/// `height`: of the `velo` origin over the road (m). Deterministic by (seed, index, look, seconds).
MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds);

}  // namespace mirage::generator
