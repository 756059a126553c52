// What a vehicle puts around the object on its roof for the light model with visibility.
#pragma once

#include "scene/carrier.h"
#include "scene/frame.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Linear albedo of the road, where nothing tells it.
inline constexpr double kRoadAlbedo = 0.18;

/// Paint (linear albedo) of a labelled vehicle from the photograph: the median of the label's 2-D box away
/// from roof and road, divided by the plain model's light on an upright face.
Vec3d vehicle_paint(const Frame& frame, const Label& host);

/// Roof, outline and road of the fitted vehicle where there is one, else of the saloon in the label's box.
LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier);

}  // namespace mirage
