// A sensor of a frame as an insertion sees it: what the placed object changes of its measurement, and the way
// back. Cameras and the LiDAR are passes (insertion.cpp), and so is every sensor plugin (sensor_plugin.h).
#pragma once

#include <array>
#include <functional>
#include <vector>

#include "simulation/adversary_lidar.h"
#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

// The insertion's VJP over the caller's own memory, in float or in double, and what an insertion holds beyond
// float: for hosts whose arrays are not Mirage's (plugins/python), and for derivatives that are to be
// checked.

/// d loss / d image and d loss / d points, read where they lie. Nothing is copied; of the image only the
/// pixels of Simulated::rect are read, of the points only the returns on the object.
struct Upstream {
  GradientView image = {};  ///< height × width × 3, row-major
  int width = 0, height = 0;
  GradientView points = {};                     ///< one a point of Simulated::sweep; empty: none
  const LidarSilhouette* silhouette = nullptr;  ///< of the placed adversary; null: held fixed
  GradientView presence = {};                   ///< one a place of it; empty: none
  /// As `image`, of each of Simulated::others, then of each of Simulated::measurements, in the measurement's
  /// shape: none where there is none, empty if there is none of any.
  std::vector<GradientView> others = {};
};

/// As simulate_vjp of simulation/insertion.h. In double, what was drawn with SimulationSettings::reference
/// keeps the upstream's precision.
AdversaryGradient simulate_vjp(const Simulated& simulated, const Upstream& upstream);

/// The returns on the object (x, y, z in `velo`, m; reflectance) in double, in their order at the end of
/// Simulated::sweep.
std::vector<std::array<double, 4>> object_returns(const Simulated& simulated);

/// The adversary as it stands in `velo`.
const TexturedMesh& placed_adversary(const Simulated& simulated);

/// The way back of one drawing: adds d loss / d vertices (of the placed object, `velo`) and d loss / d texels
/// to `placed`, by this sensor's part of the upstream. `simulated`: what the drawing was into.
using SensorVjp = std::function<void(const Simulated& simulated, const TexturedMesh& object,
                                     const Upstream& upstream, AdversaryGradient& placed)>;

/// One sensor. Several threads may draw at once.
class SensorPass {
 public:
  virtual ~SensorPass() = default;
  /// Writes this sensor's measurement with the object in it into `result`. `placed`: in `velo`. Null where
  /// the object changes nothing and there is no way back.
  virtual SensorVjp draw(const PreparedFrame& prepared, const Placement& placement,
                         const TexturedMesh& placed, const SimulationSettings& settings,
                         Simulated& result) const = 0;
};

}  // namespace mirage
