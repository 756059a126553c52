// The LiDAR's side of the speed–accuracy study: the rays of one sweep that can meet one host's object, traced
// in several ways.
//
// Reference: every ray against every face by Möller–Trumbore in double, the nearest hit. A ray that is left
// out takes the range of the nearest traced one of its beam. The gradient is that of Σ w·range, with w a
// fixed smooth weight over the rays, to the placed vertices; where rays are left out the traced ones count
// for them.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "simulation/insertion.h"

namespace mirage {

struct LidarFigures {
  std::string axis, label;
  nlohmann::json settings;
  int rays = 0;                                   ///< traced
  double range_error = 0, range_max = 0;          ///< m, mean and largest, rays that hit in both
  double disagreements = 0;                       ///< rays that hit in one only, over the reference's hits
  double gradient_cosine = 0, gradient_norm = 0;  ///< against the reference's; 0 where there is none
  bool has_gradient = true;
  double ms = 0, baseline_ms = 0, ratio = 1;  ///< CPU time; the baseline is what simulate() does
};

/// Axes: "arithmetic" (Embree's own float range; its face and the range in double, as simulate() has it; all
/// in double), "rays" (every 1st, 2nd, 4th, 8th ray of a beam), and "beam" (one thin ray against the cone of
/// 19 that the unit's divergence asks for; against the cone, and only where the unit's divergence is known).
/// Empty if fewer than 8 rays hit. One thread, as CameraStudy::measure.
std::vector<LidarFigures> lidar_study(const PreparedFrame& prepared, const TexturedMesh& placed,
                                      const SimulationSettings& settings, int repeats);

}  // namespace mirage
