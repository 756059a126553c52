// A whole sweep of a generated scene, with the sensor's imperfections.
#pragma once

#include <cstdint>

#include "sensors/lidar_model.h"
#include "sensors/ray_camera.h"

namespace mirage {

struct SweepNoise {
  double range_sigma = 0.012;      ///< m
  double beam_bias_sigma = 0.008;  ///< m, constant a beam: what calibration leaves
  double angle_sigma = 2.5e-4;     ///< rad, of azimuth and elevation
  double reflectance_sigma = 0.03;
  double drop_out = 0.015;   ///< share of returns lost without a reason
  double dark_level = 0.06;  ///< reflectance that is reported as 0
  /// Signal (reflectivity · cos^0.7(incidence) / range², 1/m²) that returns with probability 1 − 1/e. Chosen
  /// so that road and cars keep KITTI's counts of points over the range.
  double signal_floor = 3e-5;
};

/// Traces every (beam, column) of the model and returns the points in `velo`, beam by beam. Glass lets most
/// rays pass. Random numbers are keyed by (seed, beam): the result does not depend on the thread count.
Sweep simulate_sweep(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                     const SweepNoise& noise = {});

}  // namespace mirage
