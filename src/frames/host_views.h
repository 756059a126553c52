// How much of a mesh on its roof each car of a frame shows.
#pragma once

#include <array>
#include <vector>

#include "frames/frame_cache.h"

namespace mirage {

/// Share in view of the reference adversary on each car of the frame inside `region` (x_min, x_max, y_min,
/// y_max; m, `velo`). `rooftops`: of the labels, in their order.
std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Rooftop>& rooftops,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation);

}  // namespace mirage
