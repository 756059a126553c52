#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/parallel.h"
#include "geometry/mesh.h"
#include "sensors/lidar_sweep.h"
#include "sensors/ray_camera.h"

namespace mirage {
namespace {

Transform looking_forward() {
  Transform camera_from_velo = Transform::Identity();
  Eigen::Matrix3d r;
  r << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  camera_from_velo.linear() = r;
  return camera_from_velo;
}

Surface quad(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d, int object) {
  Surface s;
  s.mesh.vertices = {a, b, c, d};
  s.mesh.faces = {{0, 1, 2}, {0, 2, 3}};
  s.material.albedo = Vec3f::Constant(0.4f);
  s.object = object;
  return s;
}

std::vector<Surface> ground_and_wall() {
  return {quad({-200, -200, -2}, {200, -200, -2}, {200, 200, -2}, {-200, 200, -2}, -1),
          quad({20, -3, -2}, {20, -3, 4}, {20, 3, 4}, {20, 3, -2}, 5)};
}

const PinholeCamera kPinhole{100, 100, 80, 30, 160, 60};

// Frames have a Lighting for the soft rasteriser: open ground must have the radiance that it predicts.
TEST(RayCamera, OpenGroundHasTheLightingsRadiance) {
  const std::vector<Surface> surfaces = {
      quad({-200, -200, -2}, {200, -200, -2}, {200, 200, -2}, {-200, 200, -2}, -1)};
  const RayScene scene(surfaces);
  SceneLight light;
  light.lighting.sun = Vec3d(1.5, 1.4, 1.2);
  light.lighting.ambient = Vec3d(0.1, 0.1, 0.1);
  const Vec3f sky = light.sky.irradiance(light.lighting.to_sun_velo.cast<float>());
  light.lighting.hemisphere = sky.cast<double>() - light.lighting.ambient;
  const RayImage image = render(scene, kPinhole, looking_forward(), light, {2, 4, 1});
  Vec3d mean = Vec3d::Zero();
  int count = 0;
  for (int v = 45; v < 60; ++v)
    for (int u = 0; u < 160; ++u, ++count)
      for (int c = 0; c < 3; ++c) mean[c] += image.color.at(u, v, c);
  mean /= count;
  const Lighting& l = light.lighting;
  const Vec3d expected = 0.4 * (l.ambient + l.hemisphere + l.sun * l.to_sun_velo.z());
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(mean[c], expected[c], 0.02 * expected[c]);
}

// The omitted rays would have hit the same as their neighbours.
TEST(RayCamera, SparseRaysShowTheSame) {
  const std::vector<Surface> surfaces = ground_and_wall();
  const RayScene scene(surfaces);
  RayCameraSettings full{2, 4, 1}, sparse = full;
  sparse.sparse = true;
  const RayImage a = render(scene, kPinhole, looking_forward(), {}, full),
                 b = render(scene, kPinhole, looking_forward(), {}, sparse);
  EXPECT_EQ(a.object.data, b.object.data);
  // The depth belongs to another ray of the same pixel: it lies between those of the rows above and below.
  for (int v = 1; v + 1 < kPinhole.height; ++v)
    for (int u = 0; u < kPinhole.width; ++u) {
      const float above = a.depth.at(u, v - 1), here = a.depth.at(u, v), below = a.depth.at(u, v + 1);
      if (!(above > 0 && below > 0)) continue;
      EXPECT_GE(b.depth.at(u, v), std::min({above, here, below}) - 1e-3f) << u << ", " << v;
      EXPECT_LE(b.depth.at(u, v), std::max({above, here, below}) + 1e-3f) << u << ", " << v;
    }
  double difference = 0;
  for (std::size_t i = 0; i < a.color.data.size(); ++i)
    difference += std::abs(a.color.data[i] - b.color.data[i]) / static_cast<double>(a.color.data.size());
  EXPECT_LT(difference, 2e-3);
  EXPECT_NE(a.color.data, b.color.data);
}

TEST(RayCamera, DepthAndObjectsAndShadow) {
  const RayScene scene(ground_and_wall());
  SceneLight light;
  light.lighting.to_sun_velo = Vec3d(1, 0, 0.5).normalized();  // behind the wall
  const RayImage image = render(scene, kPinhole, looking_forward(), light, {1, 4, 1});
  EXPECT_NEAR(image.depth.at(80, 30), 20, 1e-3);
  EXPECT_EQ(image.object.at(80, 30), 5);
  EXPECT_NEAR(image.depth.at(80, 50), 10, 1e-3);  // ground: 2 m down, 20 pixels under the horizon
  EXPECT_EQ(image.object.at(80, 50), -1);
  EXPECT_EQ(image.depth.at(80, 2), 0);
  // The wall's shadow reaches 12 m towards the camera between y = ±3; beside it the ground is in the sun.
  EXPECT_LT(image.color.at(80, 46), 0.6 * image.color.at(10, 46));
}

TEST(RayCamera, SameForAnyThreadCount) {
  const RayScene scene(ground_and_wall());
  set_thread_count(1);
  const RayImage one = render(scene, kPinhole, looking_forward(), {});
  set_thread_count(0);
  const RayImage many = render(scene, kPinhole, looking_forward(), {});
  EXPECT_EQ(one.color.data, many.color.data);
  EXPECT_EQ(one.object.data, many.object.data);
}

LidarModel small_lidar() {
  LidarModel model;
  for (int i = 0; i < 20; ++i) model.beams.push_back({(2 - i) * std::numbers::pi / 180, 0, 0, 0});
  model.azimuth_step = 0.004;
  model.azimuth_min = -0.14;
  model.azimuth_max = 0.14;
  model.range_min = 1;
  model.range_max = 80;
  return model;
}

TEST(LidarSweep, WallIsAtItsRange) {
  const std::vector<Surface> surfaces = {ground_and_wall()[1]};
  const RayScene scene(surfaces);
  const Sweep sweep = simulate_sweep(scene, small_lidar(), 1);
  ASSERT_GT(sweep.size(), 400u);
  double mean = 0;
  for (const LidarPoint& p : sweep) {
    EXPECT_NEAR(p.x, 20, 0.12);  // five sigma, and the jitter of oblique rays
    mean += p.x / static_cast<double>(sweep.size());
  }
  EXPECT_NEAR(mean, 20, 0.01);
}

TEST(LidarSweep, GlassLetsMostRaysPass) {
  std::vector<Surface> surfaces = {quad({20, -9, -9}, {20, -9, 9}, {20, 9, 9}, {20, 9, -9}, 5),
                                   quad({10, -9, -9}, {10, -9, 9}, {10, 9, 9}, {10, 9, -9}, 6)};
  surfaces[1].material.transparency = 0.7f;
  const Sweep sweep = simulate_sweep(RayScene(surfaces), small_lidar(), 1);
  double near = 0, far = 0;
  for (const LidarPoint& p : sweep) (p.x < 15 ? near : far) += 1;
  EXPECT_GT(far, 4 * near);
  EXPECT_GT(near, 0);
}

TEST(LidarSweep, SameForAnyThreadCount) {
  const RayScene scene(ground_and_wall());
  set_thread_count(1);
  const Sweep one = simulate_sweep(scene, small_lidar(), 9);
  set_thread_count(0);
  const Sweep many = simulate_sweep(scene, small_lidar(), 9);
  ASSERT_EQ(one.size(), many.size());
  for (std::size_t i = 0; i < one.size(); ++i) ASSERT_EQ(one[i].position(), many[i].position());
}

}  // namespace
}  // namespace mirage
