#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "base/error.h"
#include "base/files.h"
#include "generator/fit.h"
#include "generator/generator.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::filesystem::path shipped_rig() {
  return std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml";
}

TEST(Rig, ShippedRigIsKittisCar) {
  const Rig rig = read_rig(shipped_rig());
  EXPECT_EQ(rig.name, "kitti64");
  EXPECT_EQ(rig.lidar.beams.size(), 64u);
  EXPECT_EQ(rig.calibration.camera.width, 1242);
  // The image of a point straight ahead is near the principal point.
  const Vec2d pixel =
      rig.calibration.camera.project<double>(rig.calibration.camera_from_velo * Vec3d(50, 0, 0));
  EXPECT_NEAR(pixel.x(), 609.6, 10);
  EXPECT_NEAR(pixel.y(), 172.9, 15);
}

TEST(Rig, TheOneWithSixCamerasLooksAllAround) {
  const Rig rig = read_rig(shipped_rig().parent_path() / "nuscenes6.toml");
  EXPECT_EQ(rig.camera, "CAM_FRONT");
  ASSERT_EQ(rig.others.size(), 5u);
  const auto looks = [](const Calibration& calibration) {  // degrees from ahead, to the left
    const Vec3d along = calibration.camera_from_velo.linear().row(2);
    return std::atan2(along.y(), along.x()) * 180 / M_PI;
  };
  const std::map<std::string, double> ways = {
      {"CAM_BACK_LEFT", 110}, {"CAM_BACK_RIGHT", -110}, {"CAM_FRONT_LEFT", 55}, {"CAM_FRONT_RIGHT", -55}};
  for (const Rig::Side& side : rig.others) {
    if (side.name == "CAM_BACK")
      EXPECT_GT(std::abs(looks(side.calibration)), 179);
    else
      EXPECT_NEAR(looks(side.calibration), ways.at(side.name), 2) << side.name;
    EXPECT_EQ(side.calibration.camera.width, 1600);
  }
  EXPECT_EQ(rig.lidar.beams.size(), 32u);
  EXPECT_NEAR(rig.lidar.azimuth_count() * rig.lidar.azimuth_step, 2 * M_PI, 2 * rig.lidar.azimuth_step);
  const test::TemporaryFolder folder;
  std::string text = read_file(shipped_rig().parent_path() / "nuscenes6.toml");
  text.replace(text.find("cameras.CAM_BACK_LEFT"), 21, "cameras.\"../up\"");
  write_file(folder / "rig.toml", text);
  EXPECT_THAT(test::error_text<InputError>([&] { read_rig(folder / "rig.toml"); }),
              AllOf(HasSubstr("cameras"), HasSubstr("folder")));
}

TEST(RigRealFrames, PoseIsThatOfTheRealFrames) {
  MIRAGE_NEED_REAL_FRAMES();
  const Rig rig = read_rig(shipped_rig());
  int same = 0;
  for (const std::string& id : list_frames(test::real_frames())) {
    const Calibration c =
        read_calibration(test::real_frames() / "training" / "calib" / (id + ".txt"), 1242, 375);
    if (std::abs(c.camera.fx - rig.calibration.camera.fx) > 1e-9) continue;  // another day's calibration
    same += c.camera_from_velo.isApprox(rig.calibration.camera_from_velo, 1e-6);
  }
  EXPECT_GT(same, 0);
}

TEST(Rig, ErrorsNameFileAndKey) {
  test::TemporaryFolder folder;
  const std::string good = read_file(shipped_rig());
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    write_file(folder / "rig.toml", text.replace(place, from.size(), to));
    return test::error_text<InputError>([&] { read_rig(folder / "rig.toml"); });
  };
  EXPECT_THAT(with("fx =", "focal ="), AllOf(HasSubstr("rig.toml"), HasSubstr("camera.fx: missing key")));
  EXPECT_THAT(with("fx =", "fz = 1\nfx ="), HasSubstr("camera.fz: unknown key"));
  EXPECT_THAT(with("cx = 609", "cx = 6090"), AllOf(HasSubstr("camera.cx"), HasSubstr("out of range")));
  EXPECT_THAT(with("  0.000234774,", "  0.9,"),
              AllOf(HasSubstr("camera_from_velo"), HasSubstr("not a rotation")));
  EXPECT_THAT(with("[camera]", "[radar]\na = 1\n[camera]"), HasSubstr("radar: unknown key"));
  EXPECT_THAT(with("rate =", "rat ="), HasSubstr("lidar.rate: missing key"));
  EXPECT_THAT(with("width = 1242   # pixels\nheight = 375", "width = 16384\nheight = 16384"),
              AllOf(HasSubstr("rig.toml"), HasSubstr("camera.width, camera.height"), HasSubstr("pixels")));
}

TEST(Rig, AUnitOfTooManyRaysIsRefusedBeforeAnyIsMade) {
  test::TemporaryFolder folder;
  std::string rows;
  for (int i = 0; i < 400; ++i)
    rows.append("[").append(std::to_string(42 - 0.1 * i)).append(", 0.2, 0, 0],\n");
  write_file(folder / "unit.toml",
             "[lidar]\nname = \"dense\"\nvelo_from_lidar = [0, 0, 0, 0, 0, 0]\nheight = 1.7\nrate = 10\n"
             "azimuth_step = 0.01\nencoder_step = 0\nazimuth = [-180, 180]\nrange = [1, 80]\nbeams = [\n" +
                 rows + "]\n");
  EXPECT_THAT(
      test::error_text<InputError>([&] { with_lidar(read_rig(shipped_rig()), folder / "unit.toml"); }),
      AllOf(HasSubstr("unit.toml: lidar.beams, azimuth_step"), HasSubstr("400 beams of 36000 firings"),
            HasSubstr("8388608")));
}

}  // namespace

// The report on the fits of a data set, and its files.

namespace {

/// A vehicle at `range` m with `points` returns; 20 or more give a fit. Its true shape is known up to 20 m.
FittedVehicle vehicle(double range, int points) {
  FittedVehicle v;
  v.range = range;
  v.fit.points = points;
  v.fit.fitted = points >= 20;
  v.residual = range / 1000;
  v.seconds = 0.5;
  if (v.fit.fitted && range < 20)
    v.error = FitError{Vec3d(-0.1, 0.2, 0), Vec3d(0, 0, -0.3), -0.01, 0.02, 0.03};
  return v;
}

TEST(FitSummary, CountsByRangeAndByReturns) {
  const FitReport report =
      summarise_fits({vehicle(5, 500), vehicle(15, 50), vehicle(25, 25), vehicle(45, 10), vehicle(60, 2000)});
  EXPECT_EQ(report.all.vehicles, 5u);
  EXPECT_EQ(report.all.fitted, 4u);
  EXPECT_EQ(report.within_30_m.vehicles, 3u);
  EXPECT_DOUBLE_EQ(report.all.residual.median, 0.025);
  ASSERT_EQ(report.by_range.size(), 5u);
  ASSERT_EQ(report.by_returns.size(), 6u);
  for (const auto& [classes, expected] :
       {std::pair(&report.by_range, std::vector<std::size_t>{1, 1, 1, 0, 2}),
        std::pair(&report.by_returns, std::vector<std::size_t>{1, 1, 1, 0, 1, 1})})
    for (std::size_t i = 0; i < expected.size(); ++i)
      EXPECT_EQ((*classes)[i].fits.vehicles, expected[i]) << (*classes)[i].low;
  EXPECT_TRUE(std::isinf(report.by_range.back().high));
  ASSERT_TRUE(report.all.error);
  EXPECT_EQ(report.all.error->vehicles, 2u);
  EXPECT_DOUBLE_EQ(report.all.error->roof[0].median, 0.1);  // without its sign
  EXPECT_DOUBLE_EQ(report.all.error->distance.p95, std::hypot(0.1, 0.2));
  EXPECT_FALSE(report.by_range.back().fits.error);
}

TEST(FitSummary, AsFilesHoldIt) {
  const nlohmann::json json = to_json(summarise_fits({vehicle(5, 500), vehicle(45, 10)}));
  EXPECT_EQ(json.at("by_range").at(0).at("range_m"), (nlohmann::json{0.0, 10.0}));
  EXPECT_EQ(json.at("by_range").at(4).at("range_m"), (nlohmann::json{40.0, nullptr}));
  EXPECT_EQ(json.at("by_returns").at(0).at("returns").dump(), "[0,20]");
  EXPECT_EQ(json.at("by_returns").at(5).at("returns").dump(), "[1000,null]");
  const auto& all = json.at("all");
  EXPECT_EQ(all.at("vehicles"), 2);
  EXPECT_EQ(all.at("fitted"), 1);
  EXPECT_EQ(all.at("from_box"), 1);
  EXPECT_EQ(all.at("residual_m"), (nlohmann::json{{"median", 0.005}, {"p95", 0.005}}));
  EXPECT_EQ(all.at("roof_over_box_m"), (nlohmann::json{{"p05", 0.0}, {"median", 0.0}, {"p95", 0.0}}));
  const auto& error = all.at("error");
  EXPECT_EQ(error.at("vehicles"), 1);
  EXPECT_EQ(error.at("roof_y_m").at("median"), 0.2);
  EXPECT_EQ(error.at("box_z_m").at("median"), 0.3);
  EXPECT_EQ(error.at("yaw_rad").at("median"), 0.01);
  EXPECT_EQ(error.at("fitted_to_true_m").at("median"), 0.02);
  EXPECT_EQ(error.at("true_to_fitted_m").at("median"), 0.03);
  EXPECT_FALSE(json.at("by_range").at(4).contains("error"));
}

}  // namespace
}  // namespace mirage
