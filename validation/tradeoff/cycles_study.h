// Blender Cycles in the speed–accuracy study: samples a pixel and light effects, against all effects at many
// samples; and where the rasteriser's own picture lies on that scale.
#pragma once

#include <filesystem>
#include <vector>

#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/camera_study.h"
#include "validation/tradeoff/points.h"

namespace mirage {

struct CyclesHost {
  const PreparedFrame* prepared = nullptr;
  Placement placement;
  TexturedMesh adversary;
  std::string name;
};

/// Points of group "cycles", axes "rung" and "samples" (without fronts). Times are wall-clock: Cycles uses
/// all cores. Errors over the object's pixels, nothing in front of it: image_levels, image_mae,
/// image_relative (image_mae over the mean radiance).
std::vector<TradeoffPoint> cycles_study(ReferenceRenderer& renderer, const std::vector<CyclesHost>& hosts,
                                        const SimulationSettings& baseline, int reference_samples,
                                        std::uint64_t seed, const std::filesystem::path& scratch);

}  // namespace mirage
