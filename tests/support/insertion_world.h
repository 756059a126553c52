// One car in an otherwise empty world, and an adversary for its roof.
#pragma once

#include <cmath>

#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "simulation/insertion.h"
#include "support/random_vector.h"

namespace mirage::test {

/// An atlas of `resolution`² texels per face, of random colours.
inline void paint(TexturedMesh& adversary, int resolution, RandomStream& random) {
  TexelAtlas& atlas = adversary.atlas;
  atlas.resolution = resolution;
  atlas.texels.clear();
  const auto side = as_size(resolution);
  for (std::size_t t = 0; t < side * side * adversary.mesh.faces.size(); ++t)
    atlas.texels.push_back(random_vector(random, .2, .9));
}

/// Moves vertices by up to 0.2 m along each axis, so that faces hide and intersect each other.
inline void crumple(Mesh& mesh, RandomStream& random) {
  for (Vec3d& v : mesh.vertices) v += random_vector(random, -.2, .2);
}

/// A KITTI-like rig over an empty world with one car 12 m ahead, a bit to the left.
struct World {
  PreparedFrame prepared;
  Placement placement;  ///< on the car's roof
  TexturedMesh adversary;
};

/// Settings with smooth central differences.
inline SimulationSettings smooth_settings() {
  SimulationSettings settings;
  settings.raster.sigma = 1e-4;
  settings.raster.gamma = 5e-2;
  settings.raster.dist_eps = 1e-13;  // no jump at the cut-off
  settings.reference = true;         // differences of float images are noise
  return settings;
}

inline World make_world(std::uint64_t seed, const Sweep& sweep = {}) {
  World world;
  Frame frame;
  PinholeCamera& camera = frame.calibration.camera;
  Transform& camera_from_velo = frame.calibration.camera_from_velo;
  camera = {120.3, 120.3, 101.6, 28.8, 207, 63};  // KITTI at a sixth
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  camera_from_velo.linear() = axes;
  camera_from_velo.translation() = Vec3d(0, -0.08, -0.27);
  RandomStream random(seed, "insertion test");
  frame.image = ImageF(camera.width, camera.height, 3, 0.4f);
  frame.sweep = sweep;
  frame.lighting.to_sun_velo = Vec3d(-0.6, 0.3, 0.74).normalized();
  Label host;
  host.type = "Car";
  host.box = {{12, 1.5, 4, 1.7, 0.2}, -1.7, 1.5};
  frame.labels = {host};

  LidarModel lidar;
  for (int beam = 0; beam < 32; ++beam) lidar.beams.push_back({(2 - 0.4 * beam) * M_PI / 180});
  lidar.azimuth_step = 0.2 * M_PI / 180;
  lidar.azimuth_min = -0.8;
  lidar.azimuth_max = 0.8;
  lidar.range_min = 1;
  lidar.range_max = 100;
  world.prepared = prepare(frame, lidar);
  world.placement = on_roof(BoxRoofFinder().find(frame, host));

  Mesh& mesh = world.adversary.mesh;
  mesh = icosphere(1);
  for (Vec3d& v : mesh.vertices) v = v.cwiseProduct(Vec3d(.7, .7, .45)) + random_vector(random, -.04, .04);
  paint(world.adversary, 1, random);  // the forward pass jumps at texel borders
  return world;
}

}  // namespace mirage::test
