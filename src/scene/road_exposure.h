// How bright a recorded frame's light is, from the road in its photograph.
//
// KITTI says nothing of its light. The road ahead is the one surface of known colour that nearly every frame
// shows: worn asphalt, kRoadAlbedo. The light model's strengths are scaled, channel by channel, until it
// draws level asphalt as bright as the photograph has it, so that an object, the paint of its host and the
// exported ground fit the picture. The direction of the sun is not touched.
#pragma once

#include <optional>

#include "scene/frame.h"

namespace mirage {

/// Median radiance (linear RGB, 1: white) of the road's returns: x 5 to 20 m ahead, |y| ≤ 1.5 m, within 0.15
/// m of the ground there, in view and in no labelled box. None where fewer than 50 returns tell.
std::optional<Vec3d> road_radiance(const Frame& frame);

/// `frame.lighting` scaled so that level ground of kRoadAlbedo has that radiance, each channel by 1/2 to 3
/// (beyond, the road is shaded or glares and says little of the rest); as it is where the road is not seen.
Lighting with_road_exposure(const Frame& frame);

}  // namespace mirage
