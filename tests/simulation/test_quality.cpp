// --quality: what the names stand for, and that what the user gives wins.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "base/error.h"
#include "simulation/quality.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::HasSubstr;

TEST(Quality, DefaultIsWhatTheSimulationHoldsByItself) {
  const SimulationSettings own;
  SimulationSettings settings;
  settings.raster.sigma = 1, settings.raster.gamma = 1, settings.raster.dist_eps = 0.3;
  settings.supersampling = 7, settings.reference = true, settings.exact_coverage = true;
  apply_quality("default", settings);
  EXPECT_EQ(settings.raster.sigma, own.raster.sigma);
  EXPECT_EQ(settings.raster.gamma, own.raster.gamma);
  EXPECT_EQ(settings.raster.dist_eps, own.raster.dist_eps);
  EXPECT_EQ(settings.supersampling, own.supersampling);
  EXPECT_EQ(settings.reference, own.reference);
  EXPECT_EQ(settings.exact_coverage, own.exact_coverage);
}

TEST(Quality, ThreeNamesInOrderOfTheirImage) {
  ASSERT_EQ(qualities().size(), 3u);
  EXPECT_STREQ(qualities()[0].name, "draft");
  EXPECT_STREQ(qualities()[1].name, "default");
  EXPECT_STREQ(qualities()[2].name, "exact");
  EXPECT_LT(qualities()[0].supersampling, qualities()[1].supersampling);
  EXPECT_FALSE(qualities()[1].exact);
  EXPECT_TRUE(qualities()[2].exact);
}

TEST(Quality, WhatTheUserGaveStays) {
  const Quality& draft = quality_of("draft");
  for (const std::string given : {"--sigma", "--gamma", "--supersampling"}) {
    SimulationSettings settings;
    settings.raster.sigma = 3e-6, settings.raster.gamma = 0.05, settings.supersampling = 7;
    apply_quality("draft", settings, [&](const char* option) { return option == given; });
    EXPECT_EQ(settings.raster.sigma, given == "--sigma" ? 3e-6 : draft.sigma);
    EXPECT_EQ(settings.raster.gamma, given == "--gamma" ? 0.05 : draft.gamma);
    EXPECT_EQ(settings.supersampling, given == "--supersampling" ? 7 : draft.supersampling);
    EXPECT_EQ(settings.raster.dist_eps, draft.dist_eps);
  }
}

TEST(Quality, ExactAreasHaveNoSoftnessToGive) {
  for (const std::string given : {"--sigma", "--gamma", "--supersampling"}) {
    SimulationSettings settings;
    const std::string text = test::error_text<InputError>(
        [&] { apply_quality("exact", settings, [&](const char* option) { return option == given; }); });
    EXPECT_THAT(text, HasSubstr(given));
    EXPECT_THAT(text, HasSubstr("exact"));
    EXPECT_FALSE(settings.exact_coverage);
  }
}

TEST(Quality, NothingElseChanges) {
  SimulationSettings settings;
  settings.lidar_reflectivity = 0.3, settings.occlusion_margin = 0.1, settings.grazing_cosine = 0.2;
  settings.raster.edge_on_altitude = 1e-5;
  apply_quality("draft", settings);
  EXPECT_EQ(settings.lidar_reflectivity, 0.3);
  EXPECT_EQ(settings.occlusion_margin, 0.1);
  EXPECT_EQ(settings.grazing_cosine, 0.2);
  EXPECT_EQ(settings.raster.edge_on_altitude, 1e-5);
  const SimulationSettings before = settings;
  apply_quality("", settings);
  EXPECT_EQ(settings.supersampling, before.supersampling);
}

TEST(Quality, AnotherWordIsAnErrorThatNamesTheThree) {
  SimulationSettings settings;
  const std::string text = test::error_text<InputError>([&] { apply_quality("best", settings); });
  EXPECT_THAT(text, testing::StartsWith("quality: best: "));
  for (const char* name : {"best", "draft", "default", "exact"}) EXPECT_THAT(text, HasSubstr(name));
}

}  // namespace
}  // namespace mirage
