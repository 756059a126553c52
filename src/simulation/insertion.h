// One placed adversary, seen by all cameras and the LiDAR, with occlusion both ways, and the VJP of that.
#pragma once

#include <array>
#include <vector>

#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

class DepthCompletion;

/// InputError, naming it, for a number in the frame or the model that is not finite, and for an image that is
/// not of the calibration's size. The photograph's depth comes from `depth`; without one, from IpBasic. Those
/// of other cameras come from it when something is first drawn there: it lives as long as a frame that has
/// some. `completed`: the first photograph's, where it is there already.
PreparedFrame prepare(Frame frame, const LidarModel& lidar, const DepthCompletion* depth = nullptr,
                      ImageF completed = {});

/// `adversary` in the adversary frame; it is drawn in every camera that sees it, and hidden there by what
/// that camera's own depth shows. Faces that cross the camera's near plane are clipped. InputError, naming
/// it, for a number that is not finite in any input.
Simulated simulate(const PreparedFrame& prepared, const Placement& placement, const TexturedMesh& adversary,
                   const SimulationSettings& settings = {});

/// VJP: d loss / d image (H×W×3, whole image) and d loss / d (x, y, z, reflectance) of every point of
/// simulated.sweep → adversary. Either may be empty (modality gating). InputError if what is
/// read of them is not finite.
AdversaryGradient simulate_vjp(const Simulated& simulated, const ImageF& d_image,
                               const std::vector<std::array<float, 4>>& d_points);

}  // namespace mirage
