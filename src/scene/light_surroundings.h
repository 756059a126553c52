// What a vehicle puts around the object on its roof for the light model with visibility.
#pragma once

#include "scene/frame.h"
#include "scene/rooftop.h"
#include "sensors/visible_light.h"

namespace mirage {

/// An ordinary saloon as shares of the labelled box: the car that stands where no vehicle was fitted
/// (exchange/host_proxy.h builds it, this file takes its roof and outline from it).
namespace saloon {
inline constexpr double kRoofRear = -0.32, kRoofFront = 0.08, kRoofWidth = 0.76;  // of length, length, width
inline constexpr double kWaist = 0.58;                                            // of the height
}  // namespace saloon

/// Linear albedo of the road, where nothing tells it.
inline constexpr double kRoadAlbedo = 0.18;

/// Paint (linear albedo) of a labelled vehicle from the photograph: the median of the label's 2-D box away
/// from roof and road, divided by the plain model's light on an upright face.
Vec3d vehicle_paint(const Frame& frame, const Label& host);

/// Roof, outline and road of the fitted vehicle where the rooftop has one, else of the saloon in the label's
/// box.
LightSurroundings light_surroundings(const Frame& frame, const Label& host, const Rooftop& rooftop);

}  // namespace mirage
