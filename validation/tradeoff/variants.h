// The camera settings that the speed–accuracy study goes through.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "validation/tradeoff/camera_study.h"

namespace mirage {

/// One axis at a time around `baseline`: sigma, gamma, cut_off, edges (soft, hard), samples, image_scale,
/// arithmetic (float, double), and what each --quality ships (axis "quality").
std::vector<CameraVariant> axis_variants(const SimulationSettings& baseline);
/// All combinations of some σ, γ, cut-offs and samples, in float (axis "grid"). The baseline and every
/// quality are among them.
std::vector<CameraVariant> grid_variants(const SimulationSettings& baseline);

/// What a point's "settings" hold.
nlohmann::json settings_json(const CameraVariant& variant);

}  // namespace mirage
