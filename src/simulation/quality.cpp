#include "simulation/quality.h"

#include <array>

#include "base/error.h"
#include "base/fields.h"
#include "base/words.h"

namespace mirage {

std::span<const Quality> qualities() {
  static const SimulationSettings own;
  static const std::array<Quality, 3> all = {
      Quality{"draft", 1e-7, 3e-3, 1e-4, 1, false, false},
      Quality{"default", own.raster.sigma, own.raster.gamma, own.raster.dist_eps, own.supersampling,
              own.reference, false},
      Quality{"exact", own.raster.sigma, own.raster.gamma, own.raster.dist_eps, own.supersampling,
              own.reference, true},
  };
  return all;
}

const Quality& quality_of(const std::string& name) {
  for (const Quality& quality : qualities())
    if (name == quality.name) return quality;
  throw unknown_word("quality", name, {"draft", "default", "exact"});
}

void apply_quality(const std::string& name, SimulationSettings& settings,
                   const std::function<bool(const char* option)>& given) {
  if (name.empty()) return;
  const Quality& quality = quality_of(name);
  const auto free = [&](const char* option) { return !given || !given(option); };
  for (const char* option : kSoftOptions)
    if (quality.exact && !free(option))
      throw InputError(option, "", "means nothing at --quality exact, which draws exact areas",
                       "leave it out, or choose draft or default");
  if (free("--sigma")) settings.raster.sigma = quality.sigma;
  if (free("--gamma")) settings.raster.gamma = quality.gamma;
  if (free("--supersampling")) settings.supersampling = quality.supersampling;
  settings.raster.dist_eps = quality.dist_eps;
  settings.reference = quality.reference;
  settings.exact_coverage = quality.exact;
}

}  // namespace mirage
