// Checks that a data set agrees with its rig; warns once, before a command works on it.
#pragma once

#include <filesystem>
#include <string>

namespace mirage {

/// Statistics of a few frames of a data set, evenly spread over the set.
struct DataStatistics {
  std::size_t frames = 0;         ///< with readable sweep, calibration and labels
  std::size_t returns = 0;        ///< of their sweeps
  double on_rays = 0;             ///< share of them that SweepIndex::assigned_share() counts
  std::size_t beams = 0;          ///< that meet level ground within 30 m, among those with returns
  std::size_t beams_without = 0;  ///< of those: without returns (one in 50 of the fullest beam's are strays)
  std::size_t odd_reflectance = 0;    ///< those with a reflectance outside [0, 1]
  float highest = 0;                  ///< reflectance
  std::size_t cars = 0;               ///< labelled, within 50 m, less than half occluded
  std::size_t cars_with_returns = 0;  ///< of those
};

/// Reads up to `frames` frames. Skips unreadable frames: the code that needs them reports why.
DataStatistics data_statistics(const std::filesystem::path& data, const std::string& rig,
                               std::size_t frames = 4);

/// Whether the caller casts rays of the unit (an inserted object's returns), or only reads sweeps.
enum class UnitUse { casts_rays, reads_sweeps };

/// Warns, once per process and data set, of contradictions to the rig (data_rig.h): less than 95 % of the
/// returns on a ray of its unit, a quarter of its beams that meet the ground without returns, reflectances
/// outside [0, 1], labelled cars without a return. InputError instead of the first warning if rays are cast
/// and the rig is only assumed (rig_is_assumed). Reads a few sweeps; the result depends neither on threads
/// nor on the caller's frames.
void check_data(const std::filesystem::path& data, const std::string& rig, UnitUse use);

}  // namespace mirage
