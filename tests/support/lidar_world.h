// An object in front of a LiDAR, without a camera: only the inputs of draw_in_lidar.
#pragma once

#include <cmath>

#include "base/random.h"
#include "geometry/mesh.h"
#include "simulation/adversary_lidar.h"
#include "support/random_vector.h"

namespace mirage::test {

/// 32 beams by 0.4°, 0.2° apart in azimuth, all returns at once unless `rate` is set.
inline LidarModel lidar_of_32(double rate = 0) {
  LidarModel lidar;
  for (int beam = 0; beam < 32; ++beam)
    lidar.beams.push_back({(2 - 0.4 * beam) * M_PI / 180, 0, 0, 0, rate > 0 ? 1.15e-6 * beam : 0});
  lidar.azimuth_step = 0.2 * M_PI / 180;
  lidar.azimuth_min = -0.8, lidar.azimuth_max = 0.8;
  lidar.range_min = 0.1, lidar.range_max = 600;
  lidar.rate = rate;
  return lidar;
}

/// A frame with a sweep and nothing else.
inline PreparedFrame lidar_frame(const LidarModel& lidar, Sweep sweep = {}) {
  PreparedFrame prepared;
  prepared.frame.id = "000001";
  prepared.frame.sweep = std::move(sweep);
  prepared.lidar = lidar;
  prepared.index = SweepIndex(prepared.frame.sweep, lidar);
  return prepared;
}

/// A dented sphere of the given radius around a point, with one random colour per face.
inline TexturedMesh dented_ball(const Vec3d& centre, double radius, std::uint64_t seed,
                                int subdivisions = 1) {
  TexturedMesh ball;
  RandomStream random(seed, "dented ball");
  ball.mesh = icosphere(subdivisions);
  for (Vec3d& v : ball.mesh.vertices) {
    const Vec3d dent = random_vector(random, -.06, .06);
    v = centre + radius * (v + dent);
  }
  ball.atlas.resolution = 1;
  for (std::size_t f = 0; f < ball.mesh.faces.size(); ++f)
    ball.atlas.texels.push_back(random_vector(random, .2, .9));
  return ball;
}

inline LidarPoint point_at(const LidarRay& ray, double range, float reflectance = 0.3f) {
  const Vec3f p = (ray.origin + range * ray.direction).cast<float>();
  return {p.x(), p.y(), p.z(), reflectance};
}

}  // namespace mirage::test
