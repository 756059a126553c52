// Finds the LiDAR unit that recorded sweeps, from their returns alone.
#pragma once

#include <string>
#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// A unit, and how well it explains the sweeps.
struct LidarFit {
  LidarModel lidar;         ///< beams' times, divergence and rate are no sweep's to show: 0, 0 and 10
  double on_rays = 0;       ///< share of the returns on a ray of it (SweepIndex::assigned_share)
  double firings = 0;       ///< a sweep, mean
  std::size_t returns = 0;  ///< looked at, of all sweeps
};

/// The unit of sweeps (`velo`, origin within 0.4 m of the unit's): beams as lines through the plane of
/// horizontal distance and height, the tilt, firings on a grid of azimuths with each beam's phase on it, and
/// what of the firing pattern is common to the beams. Beams are told by the order of the points where sweeps
/// are written beam by beam, else by clusters of elevation. Frames: `velo`; angles in rad, lengths in m.
/// `start`: where the unit's mount is looked for first (velo_from_lidar). InputError naming `where`: too few
/// returns, or no spinning unit explains 95 % of them.
LidarFit find_unit(const std::vector<Sweep>& sweeps, const std::string& where,
                   const Transform& start = Transform::Identity());

}  // namespace mirage
