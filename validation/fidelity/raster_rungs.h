// The rungs of the light's ladder that Mirage draws itself.
#pragma once

#include <set>
#include <string>
#include <vector>

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

}  // namespace mirage
