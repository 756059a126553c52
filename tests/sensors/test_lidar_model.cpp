#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "sensors/lidar_model.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::AllOf;
using testing::HasSubstr;

constexpr double kDegree = std::numbers::pi / 180;

std::filesystem::path shipped() {
  return std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml";
}

TEST(LidarModel, ShippedRigIsAnHdl64) {
  const LidarModel lidar = read_lidar_model(shipped());
  ASSERT_EQ(lidar.beams.size(), 64u);
  // The data sheet's nominal fan, to the degree that units are adjusted.
  for (int b = 0; b < 32; ++b) EXPECT_NEAR(lidar.beams[b].elevation / kDegree, 2 - b / 3.0, 0.5) << b;
  for (int b = 0; b < 32; ++b)
    EXPECT_NEAR(lidar.beams[b + 32].elevation / kDegree, -8.83 - b / 2.0, 0.7) << b;
  EXPECT_NEAR(2 * std::numbers::pi / lidar.azimuth_step, 2154, 5);
  EXPECT_NEAR(lidar.height, 1.73, 1e-9);
  for (int c = 0; c < lidar.azimuth_count(); ++c) {
    const double steps = lidar.firing_azimuth(c) / lidar.encoder_step;
    EXPECT_NEAR(steps, std::round(steps), 1e-6);
    EXPECT_GT(lidar.firing_azimuth(c + 1), lidar.firing_azimuth(c));
  }
}

TEST(LidarModel, RaysStartOffTheAxisAndAreUnit) {
  LidarModel lidar;
  lidar.beams = {{-0.1, 0.2, 0.026, 0.05}};
  lidar.azimuth_step = 0.01;
  lidar.azimuth_min = -0.5, lidar.azimuth_max = 0.5;
  EXPECT_EQ(lidar.azimuth_count(), 101);
  const LidarRay ray = lidar.ray(0, 60);
  EXPECT_NEAR(ray.direction.norm(), 1, 1e-14);
  EXPECT_NEAR(std::atan2(ray.direction.y(), ray.direction.x()), 0.1 + 0.05, 1e-12);
  EXPECT_NEAR(std::asin(ray.direction.z()), -0.1, 1e-12);
  EXPECT_NEAR(ray.origin.z(), 0.2, 1e-12);
  EXPECT_NEAR(ray.origin.head<2>().norm(), 0.026, 1e-12);
  // To the left of the direction, seen from above.
  EXPECT_NEAR(ray.origin.dot(Vec3d::UnitZ().cross(ray.direction)), 0.026 * std::cos(0.1), 1e-12);
}

TEST(LidarModel, MountPoseMovesRays) {
  LidarModel lidar;
  lidar.beams = {{0, 0.2, 0, 0}};
  lidar.azimuth_step = 0.1;
  lidar.velo_from_lidar.translation() = Vec3d(1, 2, 3);
  lidar.velo_from_lidar.linear() = Eigen::AngleAxisd(std::numbers::pi / 2, Vec3d::UnitZ()).matrix();
  EXPECT_TRUE(lidar.ray_at(0, 0).origin.isApprox(Vec3d(1, 2, 3.2), 1e-12));
  EXPECT_TRUE(lidar.ray_at(0, 0).direction.isApprox(Vec3d::UnitY(), 1e-12));
}

TEST(LidarModel, ErrorsNameFileAndKey) {
  test::TemporaryFolder folder;
  const std::string good = read_file(shipped());
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    write_file(folder / "rig.toml", text.replace(place, from.size(), to));
    return error_text<InputError>([&] { read_lidar_model(folder / "rig.toml"); });
  };
  EXPECT_THAT(with("azimuth_step =", "azimuth_stepp ="),
              AllOf(HasSubstr("rig.toml"), HasSubstr("lidar.azimuth_step"), HasSubstr("missing")));
  EXPECT_THAT(with("rate =", "colour = 3\nrate ="),
              AllOf(HasSubstr("rig.toml"), HasSubstr("lidar.colour"), HasSubstr("unknown key")));
  EXPECT_THAT(with("rate =", "rate = \"fast\" #"), AllOf(HasSubstr("lidar.rate"), HasSubstr("not a number")));
  EXPECT_THAT(with("rate =", "rate = -1 #"), AllOf(HasSubstr("lidar.rate"), HasSubstr("out of range")));
  EXPECT_THAT(with("range = [0.9, 80]", "range = [90, 80]"), HasSubstr("lidar.range"));
  EXPECT_THAT(with("azimuth = [-52, 52]", "azimuth = [-52]"), HasSubstr("lidar.azimuth"));
  EXPECT_THAT(with("[  1.937, 0.209, -0.026,   1.404]", "[1, 2]"), HasSubstr("lidar.beams[0]"));
  EXPECT_THAT(with("[  1.937,", "[ -1.937,"), AllOf(HasSubstr("lidar.beams"), HasSubstr("top beam down")));
  EXPECT_THAT(with("[lidar]", "[sonar]"), HasSubstr("lidar: missing key"));
  EXPECT_THAT(with("[lidar]", "[lidar"), AllOf(HasSubstr("rig.toml"), HasSubstr("line ")));
}

}  // namespace
}  // namespace mirage
