// A sweep of any unit without a renderer: level ground, with a wall around it at varying distance.
#pragma once

#include <cmath>

#include "scene/occlusion.h"

namespace mirage::test {

/// Ordered by beam with growing azimuth, like KITTI's files, or by firing, clockwise, like nuScenes'. `turn`
/// (rad): other sweeps have other walls. `first`: offset of the firings, in steps. `motion`: of the unit
/// during the sweep. Rays above the wall have no return.
inline Sweep walled_sweep(const LidarModel& lidar, double turn = 0, double first = 0,
                          const SweepMotion& motion = {}, bool by_firing = false) {
  Sweep sweep;
  const int beams = static_cast<int>(lidar.beams.size()), columns = lidar.azimuth_count();
  for (int i = 0; i < beams * columns; ++i) {
    const int beam = by_firing ? i % beams : i / columns,
              column = by_firing ? columns - 1 - i / beams : i % columns;
    const double azimuth = lidar.firing_azimuth(column) + first * lidar.azimuth_step;
    LidarRay ray = lidar.ray_at(beam, azimuth);
    if (!motion.none()) ray.origin += lidar.velo_from_lidar.linear() * motion.at(motion.phase(azimuth));
    const double wall = 18 + 9 * std::sin(3 * azimuth + turn) + 4 * std::sin(11 * azimuth - 2 * turn);
    const double slope = ray.direction.z() / ray.direction.head<2>().norm();
    double rho = wall;
    if (slope < 0) rho = std::min(rho, (lidar.height + ray.origin.z()) / -slope);
    if (ray.origin.z() + slope * rho > 6) continue;
    const Vec3d p = ray.origin + rho / ray.direction.head<2>().norm() * ray.direction;
    sweep.push_back({static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()), 0.3f});
  }
  return sweep;
}

}  // namespace mirage::test
