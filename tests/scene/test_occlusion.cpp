#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "base/random.h"
#include "base/sizes.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/occlusion.h"
#include "support/files.h"
#include "support/walled_sweep.h"

namespace mirage {
namespace {

LidarModel shipped_lidar() {
  return read_lidar_model(std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml");
}

// Returns of every (beam, column) except those that `lost` selects, at a range that varies from ray to ray.
template <class Lost>
Sweep synthetic(const LidarModel& lidar, const Lost& lost) {
  Sweep sweep;
  RandomStream random(3, "occlusion test");
  for (int b = 0; b < static_cast<int>(lidar.beams.size()); ++b)
    for (int c = 0; c < lidar.azimuth_count(); ++c) {
      const double range = random.uniform(4, 60);
      if (lost(b, c)) continue;
      const LidarRay ray = lidar.ray(b, c);
      const Vec3f p = (ray.origin + range * ray.direction).cast<float>();
      sweep.push_back({p.x(), p.y(), p.z(), 0.5f});
    }
  return sweep;
}

bool passes(const LidarRay& ray, const Vec3d& centre, double radius) {
  const Vec3d offset = centre - ray.origin;
  return offset.dot(ray.direction) > -radius && offset.cross(ray.direction).norm() <= radius;
}

TEST(SweepIndex, FindsEveryRayThroughABallAndItsReturn) {
  const LidarModel lidar = shipped_lidar();
  const auto lost = [](int b, int c) { return (b * 7 + c * 3) % 5 == 0; };
  const Sweep sweep = synthetic(lidar, lost);
  const SweepIndex index(sweep, lidar);
  EXPECT_EQ(index.firing_count(), lidar.azimuth_count());
  EXPECT_GT(index.assigned_share(), 0.9999);
  for (const auto& [centre, radius] : {std::pair(Vec3d(12, 3, 0.5), 0.8), std::pair(Vec3d(30, -9, -1), 1.0),
                                       std::pair(Vec3d(6, 0, -1), 1.5), std::pair(Vec3d(0.2, 0, 0), 1.0)}) {
    std::size_t with = 0, without = 0;
    for (int b = 0; b < 64; ++b)
      for (int c = 0; c < lidar.azimuth_count(); ++c)
        if (passes(lidar.ray(b, c), centre, radius)) ++(lost(b, c) ? without : with);
    std::set<int> points;
    std::size_t empty = 0;
    for (const SweepRay& sent : index.rays_through(centre, radius)) {
      EXPECT_NEAR(sent.ray.direction.norm(), 1, 1e-12);
      if (sent.point < 0) {
        ++empty;
        continue;
      }
      EXPECT_TRUE(points.insert(sent.point).second);
      const Vec3d there = sent.ray.origin + sent.range * sent.ray.direction;
      EXPECT_LT((there - sweep[as_size(sent.point)].position().cast<double>()).norm(), 1e-6);
    }
    // Rays through returns and the model's own differ by float rounding: only rays at the ball's rim may
    // change side.
    EXPECT_NEAR(static_cast<double>(points.size()), static_cast<double>(with),
                3 + 0.01 * static_cast<double>(with));
    EXPECT_NEAR(static_cast<double>(empty), static_cast<double>(without), 1e-9);
  }
}

TEST(SweepIndex, WorksInAMountedUnitsFrame) {
  LidarModel lidar = shipped_lidar();
  lidar.velo_from_lidar.translation() = Vec3d(0.5, -0.3, 0.2);
  lidar.velo_from_lidar.linear() =
      (Eigen::AngleAxisd(0.4, Vec3d::UnitZ()) * Eigen::AngleAxisd(0.1, Vec3d::UnitY())).matrix();
  const SweepIndex index(synthetic(lidar, [](int, int) { return false; }), lidar);
  EXPECT_GT(index.assigned_share(), 0.9999);
  for (const SweepRay& sent : index.rays_through(lidar.velo_from_lidar * Vec3d(10, 1, -0.5), 0.7))
    EXPECT_GE(sent.point, 0);
}

TEST(SweepIndex, AnEmptySweepStillHasTheModelsRays) {
  const LidarModel lidar = shipped_lidar();
  const SweepIndex index({}, lidar);
  EXPECT_EQ(index.firing_count(), lidar.azimuth_count());
  const auto rays = index.rays_through(Vec3d(10, 0, -0.5), 0.7);
  EXPECT_GT(rays.size(), 100u);
  for (const SweepRay& sent : rays) EXPECT_EQ(sent.point, -1);
}

TEST(SweepIndex, WithoutAnEncoderGridNoReturnIsLost) {
  LidarModel lidar = shipped_lidar();
  Sweep sweep = synthetic(lidar, [](int b, int c) { return (b + c) % 4 == 0; });
  lidar.encoder_step = 0;
  const SweepIndex index(sweep, lidar);
  std::set<int> points;
  for (const SweepRay& sent : index.rays_through(Vec3d::Zero(), 5))
    if (sent.point >= 0) {
      EXPECT_TRUE(points.insert(sent.point).second);
    }
  EXPECT_EQ(points.size(), sweep.size());
}

TEST(SweepIndexRealFrames, NearlyEveryReturnHasItsOwnRay) {
  MIRAGE_NEED_REAL_FRAMES();
  const LidarModel lidar = shipped_lidar();
  const auto ids = list_frames(test::real_frames());
  double sum = 0, least = 1;
  int frames = 0;
  for (std::size_t i = 0; i < ids.size(); i += 4) {
    const SweepIndex index(read_sweep(test::real_frames() / "training" / "velodyne" / (ids[i] + ".bin")),
                           lidar);
    EXPECT_GT(index.assigned_share(), 0.998) << ids[i];
    EXPECT_NEAR(index.firing_count(), 2154, 40) << ids[i];
    EXPECT_EQ(index.skipped(), 0);
    sum += index.assigned_share();
    least = std::min(least, index.assigned_share());
    ++frames;
  }
  std::printf("%d frames: %.3f %% of the returns assigned, %.3f %% in the worst\n", frames,
              100 * sum / frames, 100 * least);
}

// A unit without an encoder starts every turn at another azimuth.
TEST(SweepIndex, FindsASweepsOwnFirings) {
  LidarModel lidar = read_lidar_model(std::filesystem::path(MIRAGE_SOURCE) / "scenes/lidars/hdl32e.toml");
  lidar.azimuth_step *= 2;
  const Sweep sweep = test::walled_sweep(lidar, 1, 0.4);
  const SweepIndex index(sweep, lidar);
  EXPECT_GT(index.assigned_share(), 0.99);
  // A return's ray passes through it, starting at the unit.
  const int middle = static_cast<int>(sweep.size() / 2);
  const Vec3d p = sweep[sweep.size() / 2].position().cast<double>();
  int through = 0;
  for (const SweepRay& ray : index.rays_through(p, 1e-3)) {
    if (ray.point != middle) continue;
    ++through;
    EXPECT_LT(ray.ray.origin.norm(), 0.05);
    EXPECT_LT((ray.ray.origin + ray.range * ray.ray.direction - p).norm(), 1e-4);
  }
  EXPECT_EQ(through, 1);
}

// The sweep's own regularity must not make another unit fit.
TEST(SweepIndex, AnotherUnitsSweepStaysUnexplained) {
  const auto unit = [](const char* file) {
    return read_lidar_model(std::filesystem::path(MIRAGE_SOURCE) / "scenes" / file);
  };
  const LidarModel kitti = unit("rigs/kitti64.toml"), hdl32 = unit("lidars/hdl32e.toml"),
                   vlp16 = unit("lidars/vlp16.toml"), vls128 = unit("lidars/vls128.toml");
  EXPECT_LT(SweepIndex(test::walled_sweep(hdl32), kitti).assigned_share(), 0.7);
  EXPECT_LT(SweepIndex(test::walled_sweep(vls128), kitti).assigned_share(), 0.7);
  EXPECT_LT(SweepIndex(test::walled_sweep(kitti), hdl32).assigned_share(), 0.7);
  EXPECT_LT(SweepIndex(test::walled_sweep(vlp16), hdl32).assigned_share(), 0.7);
}

}  // namespace
}  // namespace mirage
