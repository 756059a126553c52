// The vehicle under the adversary and the road, for Blender and viewers: they catch its shadow and bounce
// light.
#pragma once

#include "exchange/gltf.h"
#include "simulation/insertion.h"

namespace mirage {

/// A closed car-shaped mesh in `velo` that fills the labelled box: body, cabin with its roof plane at the
/// box's top, four wheels. Sizes are shares of the box; the cabin's centre lies where BoxRooftopFinder puts
/// it.
Mesh car_proxy(const Box3& box);

/// A square of level road around a point of it, `reach` metres to every side, facing up.
Mesh ground_proxy(const Vec3d& centre, double reach = 40);

/// Everything of one frame with the adversary on one host. The host is the fitted vehicle where the rooftop
/// has one, with the road where its wheels stand, else car_proxy of the labelled box; its paint is taken from
/// the photograph.
ExportScene host_scene(const Frame& frame, const Label& host, const Rooftop& rooftop,
                       const TexturedMesh& adversary, const std::string& name);

}  // namespace mirage
