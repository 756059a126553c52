// A spinning LiDAR as data: its beams, its firings, its range limits and its mount pose.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "base/types.h"
#include "sensors/ray_caster.h"

namespace mirage {

/// One return: position in `velo` (m) and reflectance in [0, 1]. Layout as in KITTI's .bin files.
struct LidarPoint {
  float x = 0, y = 0, z = 0, reflectance = 0;
  /// In m, `velo`.
  Vec3f position() const { return {x, y, z}; }
};
static_assert(sizeof(LidarPoint) == 16);

/// One turn of the unit.
using Sweep = std::vector<LidarPoint>;

/// A laser of the unit. Its rays start off the unit's centre: fired at azimuth a, from the point `height` up
/// the axis and `lateral` to the left of the direction (a + azimuth_offset, elevation). Without the 0.2 m of
/// an HDL-64E's upper lasers, elevations would be wrong by 1.2° at 10 m.
struct LidarBeam {
  double elevation = 0;       ///< rad, positive up
  double height = 0;          ///< m
  double lateral = 0;         ///< m
  double azimuth_offset = 0;  ///< rad; the unit's turn until `time` is in it
  double time = 0;            ///< s, after the first laser of its firing sequence
};

/// A ray in `velo`; `direction` is a unit vector.
struct LidarRay {
  Vec3d origin, direction;
};

/// A LiDAR unit and where it is mounted.
struct LidarModel {
  std::string name;
  std::vector<LidarBeam> beams;  ///< from the top beam down
  double azimuth_step = 0;       ///< rad, mean between firings
  /// rad; firings happen on the encoder's grid: at the multiple of this nearest to column · azimuth_step. 0:
  /// no grid.
  double encoder_step = 0;
  double azimuth_min = 0, azimuth_max = 0;  ///< rad, firings kept (KITTI labels cover the front)
  double range_min = 0, range_max = 0;      ///< m
  double rate = 0;                          ///< revolutions per second
  int rotation = 1;                         ///< +1 counter-clockwise seen from above, −1 clockwise
  Vec2d divergence = Vec2d::Zero();         ///< rad, horizontal and vertical, full angle; 0: unknown
  Transform velo_from_lidar = Transform::Identity();  ///< mount pose of the unit in `velo`
  double height = 0;                                  ///< m of the `velo` origin over the ground

  /// Firings between azimuth_min and azimuth_max.
  int azimuth_count() const;
  /// Azimuth of the firing, counter-clockwise from +x, in the unit's frame; without the beam's own offset.
  double firing_azimuth(int column) const;
  /// The ray of a beam (index) fired at an azimuth (rad, unit's frame).
  LidarRay ray_at(int beam, double firing_azimuth) const;
  /// The ray of a beam in a firing (indices).
  LidarRay ray(int beam, int column) const { return ray_at(beam, firing_azimuth(column)); }
  /// When a beam fires (s): 0 is the moment at which the unit looks along its +x, the camera's moment in
  /// KITTI's recordings (Geiger et al., IJRR 2013), and firings behind it are up to half a turn away.
  double firing_time(int beam, double firing_azimuth) const;
};

/// Every ray of the model, a row a beam, a column a firing, in `velo`: to be made once and traced often.
RayTable ray_table(const LidarModel& lidar);

/// Reads the [lidar] table of a file (scenes/rigs/kitti64.toml says what each key means). A rig may name a
/// unit instead: lidar = "vlp16" at its head; or in its table, unit = "vlp16", beside the keys that are
/// another way on this car. InputError naming file and key: missing, unknown, out of range, beams not from
/// the top down.
LidarModel read_lidar_model(const std::filesystem::path& file);
/// The [lidar] table of a file, with the unit's keys where it names one.
nlohmann::json lidar_table(const std::filesystem::path& file);
/// The file of a unit: scenes/lidars/NAME.toml, or the file itself if the name ends in .toml.
std::filesystem::path lidar_file(const std::string& name);

}  // namespace mirage
