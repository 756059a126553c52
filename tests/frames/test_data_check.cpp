// Warnings about a data set that contradicts the assumptions about it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "frames/data_check.h"
#include "generator/generator.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/occlusion.h"
#include "support/files.h"
#include "support/heard.h"
#include "support/walled_sweep.h"

namespace mirage {
namespace {

using test::error_text;
using test::Heard;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

/// A frame with a small picture, walls and ten cars. `shift`: error of the labels, m.
Frame walled_frame(const std::string& rig, double shift = 0) {
  const Rig recorder = read_rig(rig_file(rig));
  Frame frame;
  frame.id = "000000";
  frame.calibration = read_rig(rig_file("kitti64")).calibration;
  PinholeCamera& camera = frame.calibration.camera;
  camera = {camera.fx / 10, camera.fy / 10, 61.5, 18.5, 124, 38};
  frame.image = ImageF(124, 38, 3, 0.25f);
  frame.sweep = test::walled_sweep(recorder.lidar);
  for (int i = 0; i < 10; ++i) {
    Label label;
    label.type = "Car";
    label.left = 10, label.top = 10, label.right = 30, label.bottom = 30;
    label.box = {{8.0 + i / 2, 0.3 * (i - 5), 4, 2, 0}, -recorder.lidar.height - 0.1 + shift, 1.5};
    frame.labels.push_back(label);
  }
  return frame;
}

TEST(DataCheck, OwnUnitsAreSilentAndOthersAreNot) {
  const TemporaryFolder folder;
  const auto data = folder / "data";
  write_frame(data, walled_frame("kitti64"));
  Heard heard;
  check_data(data, "", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 0) << heard.text();
  EXPECT_GT(data_statistics(data, "").on_rays, 0.99);
  check_data(data, "nuscenes", UnitUse::casts_rays);  // named by the user: a warning
  EXPECT_THAT(heard.text(),
              AllOf(HasSubstr("rig nuscenes"), HasSubstr("mirage rig --data"), HasSubstr("--rig")));
  check_data(data, "nuscenes", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 1) << "once";
}

TEST(DataCheck, AUnitThatIsOnlyAssumedIsRefusedWhereRaysAreCast) {
  const TemporaryFolder folder;
  const auto data = folder / "data";
  write_frame(data, walled_frame("nuscenes"));
  EXPECT_THAT(error_text<InputError>([&] { check_data(data, "", UnitUse::casts_rays); }),
              AllOf(HasSubstr("rig kitti64"), HasSubstr("assumed"), HasSubstr("mirage rig --data")));
  Heard heard;
  check_data(data, "", UnitUse::reads_sweeps);
  EXPECT_EQ(heard.warnings(), 1) << heard.text();
  check_data(data, "nuscenes", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 1) << heard.text();
  write_file(data / "dataset.json", R"({"rig": "kitti64"})");  // named by the data set: a warning
  std::filesystem::rename(data, folder / "told");
  check_data(folder / "told", "", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 2) << heard.text();
}

// With half of the beams left out, all returns lie on rays, but an object gets twice as many as it can.
TEST(DataCheck, BeamsWithoutReturnsAreSaid) {
  const TemporaryFolder folder;
  Frame frame = walled_frame("kitti64");
  const LidarModel lidar = read_rig(rig_file("kitti64")).lidar;
  const std::vector<int> beams = beams_of(frame.sweep, lidar);
  Sweep thinned;
  for (std::size_t i = 0; i < beams.size(); ++i)
    if (beams[i] % 2 == 0) thinned.push_back(frame.sweep[i]);
  frame.sweep = thinned;
  write_frame(folder / "data", frame);
  const DataStatistics look = data_statistics(folder / "data", "");
  EXPECT_GT(look.on_rays, 0.98);
  EXPECT_NEAR(static_cast<double>(look.beams_without), static_cast<double>(look.beams) / 2, 1);
  Heard heard;
  check_data(folder / "data", "", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 1) << heard.text();
  EXPECT_THAT(heard.text(), AllOf(HasSubstr("beams that meet level ground"), HasSubstr("mirage rig --data")));
}

TEST(DataCheck, ReflectancesAndLabelsThatContradictAreSaid) {
  const TemporaryFolder folder;
  Frame frame = walled_frame("kitti64", 40);
  for (LidarPoint& point : frame.sweep) point.reflectance *= 255;
  write_frame(folder / "data", frame);
  Heard heard;
  check_data(folder / "data", "", UnitUse::casts_rays);
  EXPECT_THAT(heard.text(), AllOf(HasSubstr("100.0 % of the returns have a reflectance outside [0, 1]"),
                                  HasSubstr("0 of 10 labelled cars")));
  EXPECT_EQ(heard.warnings(), 2);
}

TEST(DataCheck, RealFramesAreTakenInSilence) {
  MIRAGE_NEED_REAL_FRAMES();
  Heard heard;
  check_data(test::real_frames(), "", UnitUse::casts_rays);
  EXPECT_EQ(heard.warnings(), 0) << heard.text();
  const DataStatistics look = data_statistics(test::real_frames(), "");
  EXPECT_GE(look.on_rays, 0.9985);
  EXPECT_GE(look.cars_with_returns, 0.9 * static_cast<double>(look.cars));
}

}  // namespace
}  // namespace mirage
