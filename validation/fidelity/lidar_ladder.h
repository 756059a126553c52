// What each effect of the LiDAR changes in the returns on one attacked vehicle.
#pragma once

#include <string>
#include <vector>

#include "simulation/insertion.h"
#include "validation/reference/host_scene.h"

namespace mirage {

struct LidarRung {
  std::string effect;
  int returns = 0;  ///< on the object
  double changed =
      0;  ///< share of the ideal returns that are lost or moved, and new ones, over the ideal count
  double returns_change = 0;  ///< relative change of their number
  double seconds = 0;         ///< of the whole insertion
  Sweep sweep;                ///< the frame's sweep with the object in it, for the detector
};

/// The effects of all rungs together: what a unit of the frame's kind adds to thin noiseless rays. Random
/// ones are drawn by the scene's seed.
LidarEffects realistic_returns(const HostScene& scene);

/// "ideal" (thin noiseless rays), then range noise (2 cm, an HDL-64E's), drop-out (10 %), divergence (the
/// unit's, or 2 mrad where its file has none), motion (15 m/s ahead, a yaw rate of 0.2 rad/s) and all
/// together. Returns are matched by beam and firing; one counts as moved beyond 1 mm.
std::vector<LidarRung> lidar_ladder(const HostScene& scene);

}  // namespace mirage
