// A ceiling as a defence: a detector that looks at nothing above a height over the road.
//
// What an attacker straps to a roof stands above it; what tells a car from everything else stands below. So
//
//     returns   higher than `height` over the road there (RoadSurface) are left out;
//     pixels    whose line of sight is nowhere below a level plane at that height, within the searched region
//               ahead, are black: with the camera near that height, what lies above the horizon.
//
// A roof of 1.5 m under a ceiling of 1.6 m leaves an object of 0.7 m its lowest 10 cm, in both sensors,
// whatever it looks like. An attacker who knows the defence has its gradient: what is left passes as it is,
// what is hidden has none, and a return that rises through the ceiling is a step, as one that leaves the
// object is.
#pragma once

#include <memory>

#include "detection/detector.h"

namespace mirage {

/// `height`: m over the road; `unit_height`: of the LiDAR unit over it, which places the level plane.
/// Training sees the same.
std::unique_ptr<Detector> under_ceiling(std::unique_ptr<Detector> inner, double height, double unit_height);

}  // namespace mirage
