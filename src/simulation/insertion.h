// One placed adversary, seen by all cameras and the LiDAR, with occlusion both ways, and its VJP.
#pragma once

#include <array>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

class DepthCompletion;

/// InputError, naming it, for a number in the frame or the model that is not finite, and for an image that is
/// not of the calibration's size. `depth` completes the photograph's depth; IpBasic if null. It completes
/// other cameras' depths when an object is first drawn there, so it must outlive a frame with other cameras.
/// `completed`: the first photograph's depth, if already computed.
PreparedFrame prepare(Frame frame, const LidarModel& lidar, const DepthCompletion* depth = nullptr,
                      ImageF completed = {});

/// Draws `adversary` (in the adversary frame) into every camera that sees it; that camera's own depth
/// occludes it. Faces that cross the camera's near plane are clipped. InputError, naming it, for a number
/// that is not finite in any input.
Simulated simulate(const PreparedFrame& prepared, const Placement& placement, const TexturedMesh& adversary,
                   const SimulationSettings& settings = {});

/// VJP: d loss / d image (H×W×3, whole image) and d loss / d (x, y, z, reflectance) of every point of
/// simulated.sweep → adversary. Either may be empty (modality gating). InputError if a value that is read is
/// not finite.
AdversaryGradient simulate_vjp(const Simulated& simulated, const ImageF& d_image,
                               const std::vector<std::array<float, 4>>& d_points);

// --quality: the simulation's settings under three names. `mirage tradeoff` measures them;
// `draft` is what its rule (validation/tradeoff/points.h) chose on eight vehicles of real frames; `exact` is
// the picture of an area-sampling camera (sensors/exact_coverage.h).

/// The settings that a quality sets. The rest of SimulationSettings (light, LiDAR) and the depth completion
/// (--depth) do not depend on it. The LiDAR's rays are exact at any quality.
struct Quality {
  const char* name;
  double sigma;       ///< edge softness, NDC² (SoftRasterSettings)
  double gamma;       ///< softness of depth ordering, share of the object's depth range
  double dist_eps;    ///< coverage below which a face is skipped (cut-off)
  int supersampling;  ///< samples a pixel along each side
  bool exact;         ///< exact areas in place of the soft rasteriser, which ignore the fields above
};

/// The options of the soft rasteriser; `exact` accepts none of them.
inline constexpr std::array<const char*, 3> kSoftOptions = {"--sigma", "--gamma", "--supersampling"};

/// draft, default and exact, in this order. `default` has the defaults of SimulationSettings.
std::span<const Quality> qualities();
/// InputError, naming the three, for another word.
const Quality& quality_of(const std::string& name);

/// Applies the quality, but keeps the options that the user set: is_set(option) tells it for each of
/// kSoftOptions. An empty name changes nothing. InputError for an unknown name, and for such an option beside
/// `exact`.
void apply_quality(const std::string& name, SimulationSettings& settings,
                   const std::function<bool(const char* option)>& is_set = {});

}  // namespace mirage
