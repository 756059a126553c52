// The car's own pose in KITTI's recordings (Geiger et al., IJRR 2013): rows of an OXTS RT 3003, of which the
// first six numbers are latitude and longitude (degrees), altitude (m), roll, pitch and yaw (rad; roll left
// side up, yaw counter-clockwise from east). Places are laid flat by Mercator's projection at the latitude of
// the sequence's first row, as the development kit does.
#pragma once

#include <filesystem>
#include <string_view>

#include "base/types.h"

namespace mirage {

/// The six numbers of a row that say where the car is.
struct OxtsRow {
  double latitude = 0, longitude = 0;   ///< degrees
  double altitude = 0;                  ///< m
  double roll = 0, pitch = 0, yaw = 0;  ///< rad
};

/// A row of the recordings' 30 numbers. InputError naming `file` and `row` for fewer than 25 (without the
/// five flags at the end), for what is no number and for what is no place on Earth.
OxtsRow oxts_row(std::string_view line, const std::filesystem::path& file, std::size_t row);

/// Where the unit stands: the world's origin is the unit's place at `first`, x points east, y north, z up
/// (m).
Transform world_from_imu(const OxtsRow& row, const OxtsRow& first);

/// s from 2000-01-01 on, of "2011-09-26 13:02:25.594360375". InputError naming `file` and `row` for another
/// form.
double stamp_seconds(std::string_view stamp, const std::filesystem::path& file, std::size_t row);

/// The `row`-th line of the file, from 0. InputError naming the file if it ends before, or the line is empty.
std::string text_line(const std::filesystem::path& file, std::size_t row);

}  // namespace mirage
