#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
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
  // A point straight ahead is near the principal point.
  const Vec2d pixel =
      rig.calibration.camera.project<double>(rig.calibration.camera_from_velo * Vec3d(50, 0, 0));
  EXPECT_NEAR(pixel.x(), 609.6, 10);
  EXPECT_NEAR(pixel.y(), 172.9, 15);
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
      AllOf(HasSubstr("unit.toml: lidar.beams, azimuth_step"), HasSubstr("400 beams of 36001 firings"),
            HasSubstr("8388608")));
}

}  // namespace
}  // namespace mirage
