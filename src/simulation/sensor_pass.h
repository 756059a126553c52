// A sensor of a frame as an insertion sees it: the object's effect on its measurement, and the VJP. Cameras
// and the LiDAR are passes (insertion.cpp), and so is every sensor plugin (sensor_plugin.h).
#pragma once

#include <array>
#include <functional>
#include <vector>

#include "simulation/adversary_lidar.h"
#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

// The insertion's VJP over the caller's own memory, in float or in double, and the values that an insertion
// holds in double: for callers with arrays of their own (plugins/python), and for checks of derivatives.

/// d loss / d image and d loss / d points, read in place without a copy. Only the image's pixels in
/// Simulated::rect and the points' returns on the object are read.
struct Upstream {
  GradientView image = {};  ///< height × width × 3, row-major
  int width = 0, height = 0;
  GradientView points = {};                     ///< one a point of Simulated::sweep; empty: none
  const LidarSilhouette* silhouette = nullptr;  ///< of the placed adversary; null: held fixed
  GradientView presence = {};                   ///< one for each of its places; empty: no gradient
  /// As `image`, for each of Simulated::others, then for each of Simulated::measurements, in its shape. A
  /// null view where there is no gradient; an empty list if there is none at all.
  std::vector<GradientView> others = {};
};

/// As simulate_vjp of simulation/insertion.h. A drawing with SimulationSettings::reference keeps the
/// precision of an upstream in double.
AdversaryGradient simulate_vjp(const Simulated& simulated, const Upstream& upstream);

/// The returns on the object (x, y, z in `velo`, m; reflectance) in double, in their order at the end of
/// Simulated::sweep.
std::vector<std::array<double, 4>> object_returns(const Simulated& simulated);

/// The placed adversary in `velo`.
const TexturedMesh& placed_adversary(const Simulated& simulated);

/// The VJP of one drawing: adds d loss / d vertices (of the placed object, `velo`) and d loss / d texels to
/// `placed`, from this sensor's part of the upstream. `simulated`: the result that the drawing filled.
using SensorVjp = std::function<void(const Simulated& simulated, const TexturedMesh& object,
                                     const Upstream& upstream, AdversaryGradient& placed)>;

/// One sensor. Several threads may draw at once.
class SensorPass {
 public:
  virtual ~SensorPass() = default;
  /// Writes this sensor's measurement with the object in it into `result`. `placed`: in `velo`. Null if the
  /// object changes nothing, so that there is no VJP.
  virtual SensorVjp draw(const PreparedFrame& prepared, const Placement& placement,
                         const TexturedMesh& placed, const SimulationSettings& settings,
                         Simulated& result) const = 0;
};

}  // namespace mirage
