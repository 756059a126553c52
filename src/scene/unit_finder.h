// Finds the LiDAR unit that recorded sweeps, from their returns alone.
#pragma once

#include <string>
#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// A unit and its agreement with the sweeps.
struct LidarFit {
  LidarModel lidar;         ///< sweeps don't show beams' times, divergence and rate: 0, 0 and 10
  double on_rays = 0;       ///< share of the returns on its rays (SweepIndex::assigned_share)
  double firings = 0;       ///< mean per sweep
  std::size_t returns = 0;  ///< used, of all sweeps
};

/// The unit of sweeps (`velo`, origin within 0.4 m of the unit's): beams as lines through the plane of
/// horizontal distance and height, the tilt, firings on a grid of azimuths with each beam's phase on it, and
/// the firing pattern common to the beams. Beams are identified by the points' order if sweeps are written
/// beam by beam, otherwise by clusters of elevation. Frames: `velo`; angles in rad, lengths in m. `start`:
/// initial guess of the unit's mount (velo_from_lidar). InputError naming `where`: too few returns, or no
/// spinning unit explains 95 % of them.
LidarFit find_unit(const std::vector<Sweep>& sweeps, const std::string& where,
                   const Transform& start = Transform::Identity());

}  // namespace mirage
