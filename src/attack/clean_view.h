// A frame without the object, as a detector may use it to compute only what the object changes.
#pragma once

#include "detection/detector.h"
#include "simulation/insertion.h"

namespace mirage {

/// Of the frame that `simulated` was made from; views of `prepared`, which must outlive it. The key is a hash
/// of the picture, the sweep and the calibration.
CleanView clean_view(const PreparedFrame& prepared, const Simulated& simulated);

}  // namespace mirage
