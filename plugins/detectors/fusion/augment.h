// What training changes about a sample on the plugin's side. (The host flips, turns and scales.)
#pragma once

#include <cstdint>

#include "network.h"

namespace mirage::fusion {

/// Thins the points by up to 40 %, shakes them by up to 2 cm, changes the picture's exposure, colour cast and
/// contrast, adds a little noise, and leaves the picture out in one sample of five. Depends on (seed, index)
/// only.
SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index);

}  // namespace mirage::fusion
