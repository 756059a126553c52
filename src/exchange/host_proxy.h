// The vehicle under the adversary and the road, for Blender and viewers: they catch its shadow and bounce
// light.
#pragma once

#include "exchange/gltf.h"
#include "simulation/insertion.h"

namespace mirage {

/// A square of level road around a point of it, `reach` metres to every side, facing up.
Mesh ground_proxy(const Vec3d& centre, double reach = 40);

/// Everything of one frame with the placed adversary. The host is the carrier's fitted shape where it has
/// one, with the road where its wheels stand, else car_proxy of the labelled box; its paint is taken from the
/// photograph. Without a carrier the adversary is alone. Of the frame's other cameras it has those that may
/// see the adversary.
ExportScene host_scene(const Frame& frame, const Placement& placement, const TexturedMesh& adversary,
                       const std::string& name);

}  // namespace mirage
