// The car's own pose in KITTI's recordings (Geiger et al., IJRR 2013): rows of an OXTS RT 3003, of which the
// first six numbers are latitude and longitude (degrees), altitude (m), roll, pitch and yaw (rad; roll left
// side up, yaw counter-clockwise from east). Places are laid flat by Mercator's projection at the latitude of
// the sequence's first row, as the development kit does.
#pragma once

#include "base/types.h"

namespace mirage {

/// The six numbers of a row that say where the car is.
struct OxtsRow {
  double latitude = 0, longitude = 0;   ///< degrees
  double altitude = 0;                  ///< m
  double roll = 0, pitch = 0, yaw = 0;  ///< rad
};

/// Where the unit stands: the world's origin is the unit's place at `first`, x points east, y north, z up
/// (m).
Transform world_from_imu(const OxtsRow& row, const OxtsRow& first);

}  // namespace mirage
