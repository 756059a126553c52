// The rungs of the light's ladder that Mirage draws itself.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "simulation/insertion.h"
#include "validation/reference/host_scene.h"

namespace mirage {

/// "hard": hard edges, the plain light. "soft": the picture as attacked, with the scene's own settings. Then
/// the hard one with the lighting done on sRGB numbers ("sRGB shading"), with the hemisphere's light spread
/// evenly
/// ("uniform ambient"), with the light model with visibility ("visible light"), and with what lens ("lens")
/// and sensor ("sensor") add.
const std::vector<std::string>& raster_rungs();
/// Those that scene_features draws.
const std::set<std::string>& feature_rungs();
/// One of them.
Simulated draw_raster_rung(const std::string& rung, const HostScene& scene);

// What of a scene tells, for milliseconds, which effects of light it needs (budget.h).

/// By name: the sun's elevation (rad), its azimuth against the camera (cosine; 1: it stands behind the
/// camera) and against the vehicle's heading, its share of the light, the roof's height over the road (m),
/// the vehicle's range (m), the camera's elevation seen from the roof (rad), log of the object's pixels, its
/// visible share; and what three light-weight renders tell: soft_change and light_change, the relative change
/// of the object's visible pixels from hard edges to soft ones and from the plain light model to the one with
/// visibility. `simulated`: the scene's object, with the scene's settings; an object of no pixel changes
/// nothing.
std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated);
/// Their names, in order.
const std::vector<std::string>& scene_feature_names();

}  // namespace mirage
