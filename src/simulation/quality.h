// --quality: the simulation's settings under three names. `mirage tradeoff` measures them;
// `draft` is what its rule (validation/tradeoff/points.h) chose on eight vehicles of real frames; `exact` is
// the picture of an area-sampling camera (sensors/exact_coverage.h).
#pragma once

#include <array>
#include <functional>
#include <span>
#include <string>

#include "simulation/insertion.h"

namespace mirage {

/// What a quality sets. Everything else of SimulationSettings is none of its business: the light, the LiDAR
/// and the completion of depth (--depth) do not depend on it. The LiDAR's rays are exact at any quality.
struct Quality {
  const char* name;
  double sigma;       ///< edge softness, NDC² (SoftRasterSettings)
  double gamma;       ///< softness of depth ordering, share of the object's depth range
  double dist_eps;    ///< coverage below which a face is skipped (cut-off)
  int supersampling;  ///< samples a pixel along each side
  bool reference;     ///< plain loop in double in place of the fast rasteriser
  bool exact;         ///< exact areas in place of the soft rasteriser; the rest is then not looked at
};

/// The options for what a soft rasteriser alone has: `exact` takes none of them.
inline constexpr std::array<const char*, 3> kSoftOptions = {"--sigma", "--gamma", "--supersampling"};

/// draft, default and exact, in this order. `default` is what SimulationSettings holds by itself.
std::span<const Quality> qualities();
/// InputError naming the three for another word.
const Quality& quality_of(const std::string& name);

/// Sets what the quality sets, but for what the user gave: given(option) tells of each of kSoftOptions
/// whether it is one. An empty name changes nothing. InputError for an unknown one, and for such an option
/// beside `exact`.
void apply_quality(const std::string& name, SimulationSettings& settings,
                   const std::function<bool(const char* option)>& given = {});

}  // namespace mirage
