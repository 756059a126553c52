// The part of a sweep that detectors are given.
#pragma once

#include <vector>

#include "scene/frame.h"

namespace mirage {

/// The points in front of the camera that project into its image, in the sweep's order. KITTI labels only
/// what the camera sees, so training, detection and attack all search this part of the sweep and nothing
/// else.
std::vector<LidarPoint> points_in_view(const Sweep& sweep, const Calibration& calibration);

/// Row-major 3 × 4 projection: (u w, v w, w) = M (x, y, z, 1) for a point in `velo`.
std::array<double, 12> pixel_from_velo(const Calibration& calibration);

}  // namespace mirage
