// A spinning LiDAR as data: its beams, its firings, its range limits and its mount pose.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/types.h"

namespace mirage {

/// One return: position in `velo` (m) and reflectance in [0, 1]. Layout as in KITTI's .bin files.
struct LidarPoint {
  float x = 0, y = 0, z = 0, reflectance = 0;
  Vec3f position() const { return {x, y, z}; }
};
static_assert(sizeof(LidarPoint) == 16);

using Sweep = std::vector<LidarPoint>;

/// A laser of the unit. Its rays start off the unit's centre: fired at azimuth a, from the point `height` up
/// the axis and `lateral` to the left of the direction (a + azimuth_offset, elevation). Without the 0.2 m of
/// an HDL-64E's upper lasers, elevations would be wrong by 1.2° at 10 m.
struct LidarBeam {
  double elevation = 0;       ///< rad, positive up
  double height = 0;          ///< m
  double lateral = 0;         ///< m
  double azimuth_offset = 0;  ///< rad
};

/// A ray in `velo`; `direction` is a unit vector.
struct LidarRay {
  Vec3d origin, direction;
};

struct LidarModel {
  std::string name;
  std::vector<LidarBeam> beams;  ///< from the top beam down
  double azimuth_step = 0;       ///< rad, mean between firings
  /// rad; firings happen on the encoder's grid: at the multiple of this nearest to column · azimuth_step. 0:
  /// no grid.
  double encoder_step = 0;
  double azimuth_min = 0, azimuth_max = 0;            ///< rad, firings kept (KITTI labels cover the front)
  double range_min = 0, range_max = 0;                ///< m
  double rate = 0;                                    ///< revolutions per second
  Transform velo_from_lidar = Transform::Identity();  ///< mount pose of the unit in `velo`
  double height = 0;                                  ///< m of the `velo` origin over the ground

  /// Firings between azimuth_min and azimuth_max.
  int azimuth_count() const;
  /// Azimuth of the firing, counter-clockwise from +x, in the unit's frame; without the beam's own offset.
  double firing_azimuth(int column) const;
  /// The ray of a beam (index) fired at an azimuth (rad, unit's frame).
  LidarRay ray_at(int beam, double firing_azimuth) const;
  LidarRay ray(int beam, int column) const { return ray_at(beam, firing_azimuth(column)); }
};

/// Reads the [lidar] table of a rig file (scenes/rigs/*.toml says what each key means). InputError naming
/// file and key: missing, unknown, out of range, beams not from the top down.
LidarModel read_lidar_model(const std::filesystem::path& rig);

}  // namespace mirage
