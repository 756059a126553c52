// Units are found again from their sweeps.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
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

/// Returns as files hold them: to a millimetre, ranges a centimetre off.
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

/// Beams of `truth` that some return came from.
std::size_t beams_seen(const std::vector<Sweep>& sweeps, const LidarModel& truth) {
  std::vector<int> counts(truth.beams.size());
  for (const Sweep& sweep : sweeps)
    for (const int beam : beams_of(sweep, truth)) ++counts[static_cast<std::size_t>(beam)];
  return static_cast<std::size_t>(std::count_if(counts.begin(), counts.end(), [](int n) { return n >= 30; }));
}

struct Case {
  const char* name;
  std::string file;
  std::size_t every = 1;  ///< only each so many-th beam
  bool anywhere = false;  ///< sweeps begin at any azimuth
};

class UnitFinderTest : public testing::TestWithParam<Case> {};

TEST_P(UnitFinderTest, FindsTheUnitOfItsSweeps) {
  LidarModel truth = unit(GetParam().file);
  std::vector<LidarBeam> kept;
  for (std::size_t b = 0; b < truth.beams.size(); b += GetParam().every) kept.push_back(truth.beams[b]);
  truth.beams = kept;
  const std::vector<Sweep> sweeps = sweeps_of(truth, GetParam().anywhere);
  const FoundUnit found = find_unit(sweeps, "here");
  EXPECT_EQ(found.lidar.beams.size(), beams_seen(sweeps, truth));
  EXPECT_GE(found.on_rays, 0.99);
  EXPECT_NEAR(found.lidar.azimuth_step, truth.azimuth_step, 0.01 * truth.azimuth_step);
  EXPECT_NEAR(found.lidar.encoder_step, truth.encoder_step, 1e-4 * kDegree);
  EXPECT_NEAR(found.lidar.height, truth.height, 0.1);
  // Sweeps that it has not seen.
  Sweep other = test::walled_sweep(truth, 5.1, GetParam().anywhere ? 0.77 : 0);
  EXPECT_GE(SweepIndex(other, found.lidar).assigned_share(), 0.98);
  // As many firings as there are: a finer raster would explain any return, and invent rays.
  EXPECT_LT(found.firings, 1.05 * truth.azimuth_count() + 20);
}

INSTANTIATE_TEST_SUITE_P(Units, UnitFinderTest,
                         // kitti64's own walled sweeps are refused; generated and recorded ones are found.
                         testing::Values(Case{"Xenith", "rigs/xenith.toml"},
                                         Case{"NuScenes", "rigs/nuscenes.toml"},
                                         Case{"Vlp16", "lidars/vlp16.toml"},
                                         Case{"Hdl32Anywhere", "lidars/hdl32e.toml", 1, true}),
                         [](const auto& unit) { return unit.param.name; });

TEST(UnitFinder, PointsInAnyOrderWillDo) {
  std::vector<Sweep> sweeps = sweeps_of(unit("lidars/vlp16.toml"));
  RandomStream random(3, "order");
  for (Sweep& sweep : sweeps)
    for (std::size_t i = sweep.size(); i-- > 1;)
      std::swap(sweep[i], sweep[static_cast<std::size_t>(random.below(static_cast<int>(i) + 1))]);
  const FoundUnit found = find_unit(sweeps, "here");
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
