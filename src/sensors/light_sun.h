// The sun's rays of the light model with visibility (sensors/visible_light.h): what share of it each node
// sees, and each part of a texel.
#pragma once

#include "sensors/light_nodes.h"

namespace mirage {

/// What sees the sun.
struct SunShares {
  TexelGrid parts;               ///< of each face: its texels, or parts of them
  std::vector<float> of_parts;   ///< of each part, of the side that the camera sees
  std::vector<double> of_nodes;  ///< of each node
  std::size_t rays = 0;          ///< traced
};

/// From several points all over each side that the camera sees, and once more from all parts of the texels of
/// those that are lit in part, where the camera sees a side's texels under more than
/// `settings.sun_angle`: shadows' borders run through texels. From the others at `met_points` (of each node,
/// where other rays met it), or where that is empty all over them. `pencil` holds the object alone, about
/// nodes.centre; null for one without faces: nothing is in the way. `beside`: what else is in the way, about
/// the same point; null: nothing. `resolution`: the atlas's C.
SunShares share_sun(const LightNodes& nodes, RayPencil* pencil, RayPencil* beside,
                    const std::vector<std::vector<Vec3f>>& met_points, const Vec3d& to_sun, int resolution,
                    const VisibleLightSettings& settings);

}  // namespace mirage
