// A stand-in for the vehicle under the adversary and for the road: they catch its shadow and bounce light.
#pragma once

#include "exchange/gltf.h"
#include "scene/insertion.h"

namespace mirage {

/// A closed car-shaped mesh in `velo` that fills the labelled box: body, cabin with its roof plane at the
/// box's top, four wheels. Sizes are shares of the box; the cabin's centre lies where BoxRooftopFinder puts
/// it.
Mesh car_proxy(const Box3& box);

/// A square of the road at the box's bottom, `reach` metres to every side, facing up.
Mesh ground_proxy(const Box3& box, double reach = 40);

/// Everything of one frame with one adversary on one host: `placed` in `velo`.
ExportScene host_scene(const Frame& frame, const Label& host, const TexturedMesh& placed,
                       const std::string& name);

}  // namespace mirage
