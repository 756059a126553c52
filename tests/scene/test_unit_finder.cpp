// Units are recovered from their sweeps.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "base/sizes.h"
#include "base/types.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/occlusion.h"
#include "scene/unit_finder.h"
#include "support/files.h"
#include "support/walled_sweep.h"

namespace mirage {
namespace {

LidarModel unit(const std::string& file) {
  return read_lidar_model(std::filesystem::path(MIRAGE_SOURCE) / "scenes" / file);
}

/// Returns as files store them: to a millimetre, with range errors of a centimetre.
void roughen(Sweep& sweep, std::uint64_t seed) {
  RandomStream random(seed, "rough");
  for (LidarPoint& p : sweep) {
    const Vec3f at = p.position() * static_cast<float>(1 + 0.01 * random.normal() / p.position().norm());
    p.x = std::round(at.x() * 1000) / 1000, p.y = std::round(at.y() * 1000) / 1000,
    p.z = std::round(at.z() * 1000) / 1000;
  }
}

std::vector<Sweep> sweeps_of(const LidarModel& lidar, bool starts_anywhere = false) {
  std::vector<Sweep> sweeps;
  for (int i = 0; i < 3; ++i) {
    sweeps.push_back(test::walled_sweep(lidar, 0.7 * i, starts_anywhere ? 0.31 * i : 0));
    roughen(sweeps.back(), static_cast<std::uint64_t>(i));
  }
  return sweeps;
}

/// Number of beams of `truth` with at least 30 returns.
std::size_t beams_seen(const std::vector<Sweep>& sweeps, const LidarModel& truth) {
  std::vector<int> counts(truth.beams.size());
  for (const Sweep& sweep : sweeps)
    for (const int beam : beams_of(sweep, truth)) ++counts[as_size(beam)];
  return as_size(std::count_if(counts.begin(), counts.end(), [](int n) { return n >= 30; }));
}

struct Case {
  const char* name;
  std::string file;
  std::size_t every = 1;  ///< uses only every n-th beam
  bool anywhere = false;  ///< sweeps begin at any azimuth
};

class UnitFinderTest : public testing::TestWithParam<Case> {};

TEST_P(UnitFinderTest, FindsTheUnitOfItsSweeps) {
  LidarModel truth = unit(GetParam().file);
  std::vector<LidarBeam> kept;
  for (std::size_t b = 0; b < truth.beams.size(); b += GetParam().every) kept.push_back(truth.beams[b]);
  truth.beams = kept;
  const std::vector<Sweep> sweeps = sweeps_of(truth, GetParam().anywhere);
  const LidarFit found = find_unit(sweeps, "here");
  EXPECT_EQ(found.lidar.beams.size(), beams_seen(sweeps, truth));
  EXPECT_GE(found.on_rays, 0.99);
  EXPECT_NEAR(found.lidar.azimuth_step, truth.azimuth_step, 0.01 * truth.azimuth_step);
  EXPECT_NEAR(found.lidar.encoder_step, truth.encoder_step, 1e-4 * kDegree);
  EXPECT_NEAR(found.lidar.height, truth.height, 0.1);
  // Other sweeps than those of the fit.
  Sweep other = test::walled_sweep(truth, 5.1, GetParam().anywhere ? 0.77 : 0);
  EXPECT_GE(SweepIndex(other, found.lidar).assigned_share(), 0.98);
  // About the true number of firings: a finer raster would explain any return, and invent rays.
  EXPECT_LT(found.firings, 1.05 * truth.azimuth_count() + 20);
}

INSTANTIATE_TEST_SUITE_P(Units, UnitFinderTest,
                         testing::Values(Case{"Xenith", "rigs/xenith.toml"},
                                         Case{"NuScenes", "rigs/nuscenes.toml"},
                                         Case{"Vlp16", "lidars/vlp16.toml"},
                                         Case{"Hdl32Anywhere", "lidars/hdl32e.toml", 1, true}),
                         [](const auto& unit) { return unit.param.name; });

/// Height (m, `velo`) of a beam above a distance `rho` (m) ahead.
double height_at(const LidarModel& lidar, std::size_t beam, double rho) {
  const LidarRay ray = lidar.ray_at(static_cast<int>(beam), 0);
  return ray.origin.z() + ray.direction.z() / ray.direction.head<2>().norm() * rho;
}

// Like nuScenes' sweeps: compensated to the time of their end, with the vehicle at 8 and at 15 m/s.
TEST(UnitFinder, AUnitThatMovesWithinItsSweepIsFound) {
  LidarModel truth = unit("lidars/hdl32e.toml");
  truth.azimuth_min = -std::numbers::pi, truth.azimuth_max = std::numbers::pi - truth.azimuth_step;
  std::vector<Sweep> sweeps;
  for (const double metres : {0.4, 0.75}) {
    SweepMotion motion;
    motion.whole = true, motion.cut = std::numbers::pi;
    motion.turn = {-metres, 0, 0};  // clockwise: the sweep ends at phase 0
    sweeps.push_back(test::walled_sweep(truth, metres, 0.3 * metres, motion, true));
    roughen(sweeps.back(), 1);
  }
  const LidarFit found = find_unit(sweeps, "here");
  EXPECT_EQ(found.lidar.beams.size(), 32u);
  EXPECT_GE(found.on_rays, 0.99);
  EXPECT_LT(found.firings, 1.02 * truth.azimuth_count());
  // Each beam must meet the ground or the nearest wall at the true place. Its elevation alone is not well
  // determined: a low beam only meets the ground 3 m away, where a centimetre of height is 0.2 degrees.
  for (std::size_t b = 0; b < std::min<std::size_t>(32, found.lidar.beams.size()); ++b) {
    const double slope = std::tan(truth.beams[b].elevation);
    const double rho = slope < 0 ? std::min(18.0, truth.height / -slope) : 18.0;
    EXPECT_NEAR(height_at(found.lidar, b, rho), height_at(truth, b, rho), 0.03) << b;
  }
}

// For any sweeps of a set: also with few walls in all of them, or with a beam without returns in one.
TEST(UnitFinder, OtherSweepsOfRealFramesGiveTheSameUnit) {
  MIRAGE_NEED_REAL_FRAMES();
  const auto set = open_data_set(test::real_frames());
  const std::vector<std::string> ids = set->frames();
  ASSERT_GE(ids.size(), 12u);
  for (const std::size_t first : {0u, 3u}) {
    std::vector<Sweep> sweeps;
    for (std::size_t i = 0; i < 3; ++i)
      sweeps.push_back(set->sweep(ids[(first + i * ids.size() / 3) % ids.size()]));
    const LidarFit found = find_unit(sweeps, "here");
    EXPECT_EQ(found.lidar.beams.size(), 64u) << first;
    EXPECT_GE(found.on_rays, 0.99) << first;
    EXPECT_NEAR(found.lidar.encoder_step, 0.09 * kDegree, 1e-4 * kDegree) << first;
    EXPECT_GE(SweepIndex(set->sweep(ids[first + 7]), found.lidar).assigned_share(), 0.99) << first;
  }
}

TEST(UnitFinder, PointsInAnyOrderWillDo) {
  std::vector<Sweep> sweeps = sweeps_of(unit("lidars/vlp16.toml"));
  RandomStream random(3, "order");
  for (Sweep& sweep : sweeps)
    for (std::size_t i = sweep.size(); i-- > 1;)
      std::swap(sweep[i], sweep[as_size(random.below(static_cast<int>(i) + 1))]);
  const LidarFit found = find_unit(sweeps, "here");
  EXPECT_GE(found.on_rays, 0.99);
}

TEST(UnitFinder, WhatNoSpinningUnitRecordedIsRefused) {
  RandomStream random(7, "cloud");
  Sweep cloud;
  for (int i = 0; i < 30000; ++i)
    cloud.push_back({static_cast<float>(random.uniform(-30, 30)), static_cast<float>(random.uniform(-30, 30)),
                     static_cast<float>(random.uniform(-3, 5)), 0.5f});
  const std::string said = test::error_text<InputError>([&] { find_unit({cloud}, "here"); });
  EXPECT_THAT(said, testing::StartsWith("here: sweeps: "));
  EXPECT_THAT(test::error_text<InputError>([&] {
                find_unit({Sweep(10, {1, 2, 3, 0})}, "here");
              }),
              testing::HasSubstr("too few"));
}

}  // namespace
}  // namespace mirage
