// The host's sensor data as tensors.
#pragma once

#include "detection/detector_abi3.h"
#include "sensor_tensors.h"

namespace mirage::fusion {

/// Views of the host's memory, which lives until its next call. Without a picture where there is none, or
/// none is wanted.
SensorTensors view_input(const MirageSensorInput& input, bool with_image);
/// Own copies: the host may free its memory while a graph lives on.
SensorTensors copy_input(const MirageSensorInput& input, bool with_image);

}  // namespace mirage::fusion
