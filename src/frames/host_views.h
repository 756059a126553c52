// How much of a mesh that is placed at each car of a frame is in view.
#pragma once

#include <array>
#include <vector>

#include "frames/frame_cache.h"

namespace mirage {

/// Share in view of the reference adversary at `place` of each car of the frame inside `region` (x_min,
/// x_max, y_min, y_max; m, `velo`). `carriers`: of the labels, in their order.
std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Carrier>& carriers,
                                 const PlaceChoice& place, const std::array<double, 4>& region,
                                 const SimulationSettings& simulation);

}  // namespace mirage
