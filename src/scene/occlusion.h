// A measured sweep by angle: which returns lie in an angular window, and which rays of the sensor model have a
// measured return. Angles are taken in the unit's own frame (LidarModel::velo_from_lidar).
#pragma once

#include <vector>

#include "sensors/lidar_model.h"

namespace mirage {

/// Direction of a point in the unit's frame.
struct BeamAngles {
  double azimuth = 0;    ///< rad, counter-clockwise from +x, (−π, π]
  double elevation = 0;  ///< rad, positive up
  double range = 0;      ///< m
};
BeamAngles beam_angles(const LidarModel& lidar, const Vec3d& p_velo);

/// An index over a sweep; it keeps no reference to it.
class SweepIndex {
 public:
  SweepIndex() = default;
  SweepIndex(const Sweep& sweep, const LidarModel& lidar);

  /// Indices (rising) of the returns with azimuth and elevation in the closed window.
  /// azimuth_min ≤ azimuth_max, both in (−π, π].
  std::vector<int> window(double azimuth_min, double azimuth_max, double elevation_min, double elevation_max) const;

  /// Range of the nearest-in-angle measured return within half a beam spacing and half an azimuth step of model ray
  /// (beam, column); 0 where there is none.
  double measured_range(int beam, int column) const;

  /// Share of the returns inside the model's field that are the only one within 0.1° of their model ray.
  double assigned_share() const;

 private:
  struct Entry {
    double azimuth, elevation, range;
    int point;
  };
  std::vector<Entry> entries_;  ///< by azimuth
  std::vector<float> cells_;    ///< beams × columns: range, 0 where none
  int columns_ = 0;
  double assigned_share_ = 0;
};

}  // namespace mirage
