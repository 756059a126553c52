// What a detector is shown of a frame with an object in it.
#pragma once

#include <vector>

#include "detection/detector.h"
#include "simulation/insertion.h"

namespace mirage {

/// For a detector that can so much. Of the sensors beside the first camera and the LiDAR the view has those
/// that the detector reads by name and the object may have changed.
SensorView view_of(const PreparedFrame& prepared, const Simulated& simulated, const Capabilities& can);

/// InputError where the view shows sensors beside the first camera and the LiDAR: what draws an environment
/// (attack/expectation.h) or a picture (attack/object_renderer.h) does not know them.
void require_no_others(const SensorView& view);

/// For Upstream::others: the detector's gradient to each of Simulated::others and Simulated::measurements,
/// null where it gave none or the object changed nothing. It points into `gradient`.
std::vector<const float*> others_of(const SensorGradient& gradient, const Frame& frame,
                                    const Simulated& simulated);

/// The frame without the object, as a detector may use it to compute only what the object changes, of the
/// picture `changed`: views of `prepared`, which must outlive it. The key is a hash of the picture, the sweep
/// and the calibration.
CleanView clean_view(const PreparedFrame& prepared, const PixelRect& changed);

}  // namespace mirage
