// What training changes about a sample on the plugin's side. (The host flips, turns and scales.)
#pragma once

#include <cstdint>

#include "network.h"

namespace mirage::fusion {

/// Thins the points by up to 40 % and shakes them by up to 2 cm; with `picture`, changes its exposure, colour
/// cast and contrast and adds a little noise. (The picture is never left out: that taught detectors to do
/// without.) Depends on (seed, index) only.
SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index, bool picture);

}  // namespace mirage::fusion
