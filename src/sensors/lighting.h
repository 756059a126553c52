// The light-weight light model shared by the soft rasteriser, the exporter and the matched Cycles render.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/types.h"

namespace mirage {

/// Radiance of a Lambert face with albedo ρ and unit normal n (scene-linear RGB, per channel):
///     ρ · (ambient + hemisphere · (1 + n·up)/2 + sun · max(0, n·l))
/// Irradiances are divided by π already, so that a white face squarely under `sun` alone has radiance `sun`.
struct Lighting {
  Vec3d to_sun_velo = Vec3d(0.4, 0.5, 0.77).normalized();  ///< unit vector towards the sun, `velo`
  Vec3d sun = Vec3d(0.55, 0.53, 0.48);
  Vec3d ambient = Vec3d(0.10, 0.10, 0.11);     ///< same from everywhere
  Vec3d hemisphere = Vec3d(0.20, 0.22, 0.26);  ///< times (1 + n·up) / 2: more from above
};

}  // namespace mirage
