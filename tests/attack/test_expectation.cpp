#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "attack/expectation.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "frames/hosts.h"
#include "support/files.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

TEST(Expectation, WordsSwitchWhatVaries) {
  EXPECT_FALSE(parse_expectation("none").any());
  EXPECT_FALSE(parse_expectation("").any());
  const Expectation some = parse_expectation("sun,noise");
  EXPECT_GT(some.sun, 0);
  EXPECT_GT(some.image_noise, 0);
  EXPECT_GT(some.range_noise, 0);
  EXPECT_EQ(some.roof_shift, 0);
  EXPECT_EQ(some.exposure, 0);
  const Expectation all = parse_expectation("all");
  for (const double spread :
       {all.roof_shift, all.roof_yaw, all.sun, all.light, all.exposure, all.image_noise, all.range_noise})
    EXPECT_GT(spread, 0);
  EXPECT_THAT(test::error_text<InputError>([] { parse_expectation("roof,moon"); }),
              AllOf(HasSubstr("expectation: "), HasSubstr("moon")));
}

TEST(Expectation, DrawsHaveTheStatedSpreadAndDependOnTheirIndexAlone) {
  const Expectation e = parse_expectation("all");
  Placement known;
  known.velo_from_adversary = Eigen::Translation3d(10, 2, -0.2) * Eigen::AngleAxisd(0.7, Vec3d::UnitZ());
  double along = 0, up = 0, yaw = 0;
  constexpr int kDraws = 4000;
  for (int i = 0; i < kDraws; ++i) {
    const Placement drawn = WorldDraw(e, 5, static_cast<std::uint64_t>(i)).placement(known);
    const Transform off = known.velo_from_adversary.inverse() * drawn.velo_from_adversary;
    along += std::pow(off.translation().x(), 2) / kDraws;
    up += std::pow(off.translation().z(), 2) / kDraws;
    yaw += std::pow(std::atan2(off(1, 0), off(0, 0)), 2) / kDraws;
  }
  // Standard errors of a spread from 4000 draws: 1.1 %.
  EXPECT_NEAR(std::sqrt(along) / e.roof_shift, 1, 0.05);
  EXPECT_NEAR(std::sqrt(up) / (e.roof_shift / 5), 1, 0.05);
  EXPECT_NEAR(std::sqrt(yaw) / e.roof_yaw, 1, 0.05);
  const Placement one = WorldDraw(e, 5, 17).placement(known), same = WorldDraw(e, 5, 17).placement(known);
  EXPECT_EQ(one.velo_from_adversary.matrix(), same.velo_from_adversary.matrix());
}

TEST(Expectation, LightTurnsBrightensAndStaysAboveTheGround) {
  PreparedFrame known;
  known.frame.image = ImageF(4, 3, 3, 0.6f);
  known.frame.lighting.to_sun_velo = Vec3d(0.9, 0, 0.15).normalized();
  const Expectation e = parse_expectation("sun,light,exposure");
  double angle = 0;
  for (int i = 0; i < 200; ++i) {
    const PreparedFrame drawn = WorldDraw(e, 9, static_cast<std::uint64_t>(i)).frame(known);
    const Lighting& light = drawn.frame.lighting;
    EXPECT_NEAR(light.to_sun_velo.norm(), 1, 1e-12);
    EXPECT_GE(std::asin(light.to_sun_velo.z()), 3 * std::numbers::pi / 180 - 1e-9);
    EXPECT_GT(light.sun.minCoeff(), 0);
    angle += std::acos(std::min(1.0, light.to_sun_velo.dot(known.frame.lighting.to_sun_velo))) / 200;
    // Exposure acts on photograph and light alike; white clips.
    const double exposure = drawn.frame.image.data[0] / 0.6;
    EXPECT_GT(exposure, 0.2);
    EXPECT_LE(drawn.frame.image.data[0], 1.0f);
  }
  EXPECT_GT(angle, 0.1);
  EXPECT_EQ(WorldDraw(parse_expectation("roof"), 9, 1).frame(known).frame.image.data, known.frame.image.data);
}

TEST(Expectation, CameraNoiseStaysInRange) {
  ImageF image(60, 40, 3, 0.5f);
  WorldDraw(parse_expectation("noise"), 2, 3).add_noise(image);
  double sum = 0, squares = 0;
  for (const float value : image.data) {
    ASSERT_TRUE(value >= 0 && value <= 1);
    sum += value - 0.5;
    squares += (value - 0.5) * (value - 0.5);
  }
  const double n = static_cast<double>(image.data.size());
  EXPECT_NEAR(sum / n, 0, 5e-4);
  EXPECT_NEAR(std::sqrt(squares / n), 0.01, 4e-4);
}

}  // namespace
}  // namespace mirage
