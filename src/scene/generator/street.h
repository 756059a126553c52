// Lays out a street around the ego vehicle.
#pragma once

#include <vector>

#include "geometry/box.h"
#include "scene/generator/look.h"
#include "scene/generator/parts.h"

namespace mirage::generator {

/// A labelled thing where it stands.
struct Placed {
  std::string type;
  Box3 box;               ///< `velo`
  std::string kind = {};  ///< Actor::kind
};

/// Surfaces in `velo`; a labelled thing's surfaces carry its index in `placed` as object.
struct Street {
  std::vector<Surface> surfaces;
  std::vector<Placed> placed;
};

/// Whether the surface is something that lies on the roof of `placed`: part of the thing, but not of its
/// boxes.
bool on_roof(const Surface& surface, const Placed& placed);

/// `height`: of the `velo` origin over the road (m). Deterministic by (seed, index, look).
Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look = Look::european);

}  // namespace mirage::generator
