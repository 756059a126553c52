// The points of depth completion in a speed–accuracy study.
#pragma once

#include <string>
#include <vector>

#include "geometry/mesh.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/settings.h"

namespace mirage {

struct DepthPoints {
  std::vector<TradeoffPoint> points;  ///< group "depth", axis "back_end"
  std::string reference;              ///< in words; empty if nothing was scored
};

/// Every back-end that can be loaded on the data set's first settings.depth_frames frames (0: none), against
/// true depth where all of them have it, else on a fifth of the returns, held back. Times are wall-clock, of
/// one thread. Errors of score_depth.
DepthPoints depth_points(const TradeoffSettings& settings, const TexturedMesh& adversary);

}  // namespace mirage
