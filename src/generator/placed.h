// What a street is made of: surfaces, and the labelled things among them.
#pragma once

#include <string>
#include <vector>

#include "generator/parts.h"
#include "geometry/box.h"

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

}  // namespace mirage::generator
