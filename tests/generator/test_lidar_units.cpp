// The shipped units on generated streets: tables, rig files, and the rays recovered from points.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "generator/generator.h"
#include "generator/street.h"
#include "scene/occlusion.h"
#include "sensors/lidar_sweep.h"
#include "support/files.h"

namespace mirage {
namespace {

std::filesystem::path source() {
  return MIRAGE_SOURCE;
}

std::string unit_file(const std::string& name) {
  return (source() / "scenes/lidars" / (name + ".toml")).string();
}

Rig kitti() {
  return read_rig(source() / "scenes/rigs/kitti64.toml");
}

TEST(LidarUnits, TablesAreThoseOfTheDataSheets) {
  const LidarModel vlp16 = read_lidar_model(unit_file("vlp16")),
                   hdl32 = read_lidar_model(unit_file("hdl32e")),
                   vls128 = read_lidar_model(unit_file("vls128"));
  ASSERT_EQ(vlp16.beams.size(), 16u);
  for (int b = 0; b < 16; ++b) EXPECT_NEAR(vlp16.beams[as_size(b)].elevation / kDegree, 15 - 2 * b, 1e-9);
  ASSERT_EQ(hdl32.beams.size(), 32u);
  for (int b = 0; b < 32; ++b)
    EXPECT_NEAR(hdl32.beams[as_size(b)].elevation / kDegree, 10.67 - 4 * b / 3.0, 0.01);
  ASSERT_EQ(vls128.beams.size(), 128u);
  EXPECT_NEAR(vls128.beams.front().elevation / kDegree, 15, 1e-9);
  EXPECT_NEAR(vls128.beams.back().elevation / kDegree, -25, 1e-9);
  int dense = 0;  // 0.11° steps in the middle
  for (std::size_t b = 1; b < 128; ++b)
    dense += vls128.beams[b - 1].elevation - vls128.beams[b].elevation < 0.121 * kDegree;
  EXPECT_GT(dense, 90);
  // A clockwise unit has turned further right when its later lasers fire.
  EXPECT_EQ(vlp16.rotation, -1);
  EXPECT_NEAR(vlp16.beams[0].time, 34.56e-6, 1e-12);
  EXPECT_NEAR(vlp16.beams[0].azimuth_offset / kDegree, -360 * 10 * 34.56e-6, 1e-9);
  EXPECT_EQ(vlp16.beams[15].azimuth_offset, 0);
  for (const LidarModel* model : {&vlp16, &hdl32, &vls128}) EXPECT_NEAR(model->rate, 10, 1e-12);
}

TEST(LidarUnits, ARigWithAnotherUnitIsWrittenAndReadBack) {
  test::TemporaryFolder folder;
  for (const std::string unit : {"vlp16", "hdl32e", "vls128"}) {
    const Rig rig = with_lidar(kitti(), unit_file(unit));
    EXPECT_EQ(rig.name, "kitti64+" + unit);
    write_file(folder / "rig.toml", rig.text);
    const Rig again = read_rig(folder / "rig.toml");
    EXPECT_EQ(again.lidar.name, rig.lidar.name);
    EXPECT_EQ(again.lidar.height, kitti().lidar.height);
    EXPECT_EQ(again.calibration.camera_from_velo.matrix(), kitti().calibration.camera_from_velo.matrix());
    ASSERT_EQ(again.lidar.beams.size(), rig.lidar.beams.size());
    for (std::size_t b = 0; b < rig.lidar.beams.size(); ++b) {
      EXPECT_EQ(again.lidar.beams[b].elevation, rig.lidar.beams[b].elevation);
      EXPECT_EQ(again.lidar.beams[b].azimuth_offset, rig.lidar.beams[b].azimuth_offset);
      EXPECT_EQ(again.lidar.beams[b].time, rig.lidar.beams[b].time);
    }
  }
}

TEST(LidarUnits, ARigFileMayNameItsUnit) {
  test::TemporaryFolder folder;
  const std::string text = read_file(source() / "scenes/rigs/kitti64.toml");
  const std::string camera = text.substr(0, text.find("[lidar]"));
  write_file(folder / "rig.toml", "lidar = \"vlp16\"\n" + camera);
  const Rig rig = read_rig(folder / "rig.toml");
  EXPECT_EQ(rig.lidar.beams.size(), 16u);
  write_file(folder / "again.toml", rig.text);
  EXPECT_EQ(read_rig(folder / "again.toml").lidar.beams.size(), 16u);
  EXPECT_THAT(rig.text, testing::HasSubstr("[lidar]"));
}

TEST(LidarUnits, AUnitThatNamesAnotherIsRefused) {
  test::TemporaryFolder folder;
  write_file(folder / "scenes/lidars/loop.toml", "lidar = \"loop\"\n");
  write_file(folder / "rig.toml", "lidar = \"loop\"\n");
  setenv("MIRAGE_HOME", folder.path().c_str(), 1);
  const std::string said = test::error_text<InputError>([&] { read_lidar_model(folder / "rig.toml"); });
  unsetenv("MIRAGE_HOME");
  EXPECT_THAT(said, testing::HasSubstr("names another unit"));
}

// A rig file comes with a data set, so its author may be anybody.
TEST(LidarUnits, ARigFileReachesNoOtherFile) {
  test::TemporaryFolder folder;
  write_file(folder / "own.toml", read_file(unit_file("vlp16")));
  const std::string own = (folder / "own.toml").string();
  for (const std::string& name : {own, own.substr(0, own.size() - 5), std::string("own.toml"),
                                  std::string("../rigs/kitti64"), std::string("a\\u0000b"), std::string()})
    for (const std::string& text : {"lidar = \"" + name + "\"\n", "[lidar]\nunit = \"" + name + "\"\n"}) {
      write_file(folder / "rig.toml", text);
      EXPECT_THAT(test::error_text<InputError>([&] { read_lidar_model(folder / "rig.toml"); }),
                  testing::AllOf(testing::HasSubstr("rig.toml"), testing::HasSubstr("is not a unit's name")))
          << text;
    }
}

TEST(LidarUnits, BadUnitTablesAreNamed) {
  test::TemporaryFolder folder;
  const std::string good = read_file(unit_file("vlp16"));
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    write_file(folder / "unit.toml", text.replace(place, from.size(), to));
    return test::error_text<InputError>([&] { with_lidar(kitti(), (folder / "unit.toml").string()); });
  };
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_THAT(with("\"clockwise\"", "\"left\""), AllOf(HasSubstr("unit.toml"), HasSubstr("lidar.rotation")));
  EXPECT_THAT(with("34.56, ", ""), HasSubstr("lidar.firing_time"));
  EXPECT_THAT(with("34.56, ", "-1, "), HasSubstr("lidar.firing_time[0]"));
  EXPECT_THAT(with("divergence = [3.0, 1.2]", "divergence = 3"), HasSubstr("lidar.divergence"));
  EXPECT_THAT(with("[lidar]", "[lidar]\nrecorded_effects = \"nois\""),
              AllOf(HasSubstr("lidar.recorded_effects"), HasSubstr("nois"), HasSubstr("noise")));
  EXPECT_THAT(with("-0.0112", "-1.0112"), AllOf(HasSubstr("lidar.beams"), HasSubstr("top beam down")));
  EXPECT_THAT(with("[  15.000", "[  12.000"), HasSubstr("lidar.beams"));
  EXPECT_THAT(with("[lidar]", "[radar]"), HasSubstr("lidar: missing key"));
}

TEST(LidarUnits, GeneratedSweepsGoBackToTheirRays) {
  const auto street = generator::make_street(3, 1, 1.73);
  const RayScene scene(street.surfaces);
  for (const std::string unit : {"", "hdl32e", "vlp16", "vls128"}) {
    const LidarModel lidar = unit.empty() ? kitti().lidar : read_lidar_model(unit_file(unit));
    const Sweep sweep = simulate_sweep(scene, lidar, 1);
    EXPECT_GT(sweep.size(), 3000u);
    const SweepIndex index(sweep, lidar);
    std::printf("%s: %zu points, %.4f %% assigned\n", lidar.name.c_str(), sweep.size(),
                100 * index.assigned_share());
    EXPECT_GT(index.assigned_share(), 0.99) << lidar.name;
    // The true firing and beam of each point, without noise.
    const Firings exact = simulate_firings(scene, lidar, 1, {});
    Sweep points;
    std::vector<std::pair<int, int>> made;
    const int columns = lidar.azimuth_count();
    for (std::size_t i = 0; i < exact.ranges.size(); ++i)
      if (exact.ranges[i] > 0) {
        points.push_back(exact.points[i]);
        made.emplace_back(static_cast<int>(i) / columns, static_cast<int>(i) % columns);
      }
    const SweepIndex ideal(points, lidar);
    EXPECT_GT(ideal.assigned_share(), 0.9999) << lidar.name;
    std::size_t right = 0, all = 0;
    for (const SweepRay& sent : ideal.rays_through(Vec3d(12, 0, -0.5), 3)) {
      if (sent.point < 0) continue;
      ++all;
      const auto& [beam, column] = made[as_size(sent.point)];
      right += sent.beam == beam && std::abs(std::remainder(sent.azimuth - lidar.firing_azimuth(column),
                                                            2 * std::numbers::pi)) < 1e-4;
    }
    EXPECT_EQ(right, all) << lidar.name;
  }
}

}  // namespace
}  // namespace mirage
