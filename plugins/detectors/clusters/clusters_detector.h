// --detector clusters: finds any thing that stands on the ground, by geometry alone.
//
// After the classical stack of Autoware: the ground is taken away (ground.h), what is left is joined to
// things (cluster.h), each gets a rectangle (geometry/seen_rectangle.h). Nothing is learned, so nothing is
// foreign: a cone, a box or a car with a sculpture on it is found as what stands in the way.
//
// Each thing is Misc, which is KITTI's word for what has none, with the box that is seen. What has a car's
// size and height is also a Car, as likely as the rays into the box of a car say that shows what is seen of
// it, and so much less likely Misc. The unit stands where the ego frame does.
#pragma once

#include <vector>

#include "cluster.h"
#include "detection/detector_abi.h"

namespace mirage::clusters {

/// Places in kTypes.
enum Type { kCar, kMisc };
inline constexpr const char* kTypes[] = {"Car", "Misc"};

/// x_min, x_max, y_min, y_max (m, ego).
inline constexpr float kRegion[4] = {-70, 70, -40, 40};

/// What is found in the LiDAR sensors of a frame, with a score over the threshold, in a fixed order.
std::vector<MirageDetection> detect(const MirageFrame& frame, float score_threshold);

}  // namespace mirage::clusters
