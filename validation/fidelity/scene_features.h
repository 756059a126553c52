// What of a scene tells, for milliseconds, which effects of light it needs (budget_rule.h).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "simulation/insertion.h"
#include "validation/reference/host_scene.h"

namespace mirage {

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
