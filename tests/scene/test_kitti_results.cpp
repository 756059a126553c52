// Detections in KITTI's result format: written files are read back, other writers' files are read, bad ones
// are named.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <sstream>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

/// A calibration with all of KITTI's offsets: a tilted rectification and a colour camera beside camera 0.
Calibration calibration() {
  Calibration c;
  c.camera = {721.5377, 721.5377, 609.5593, 172.854, 1242, 375};
  c.camera_from_rect.translation() = Vec3d(0.06, -0.0003, 0.0027);
  c.rect_from_cam0 =
      (Eigen::AngleAxisd(0.01, Vec3d::UnitY()) * Eigen::AngleAxisd(-0.007, Vec3d::UnitX())).matrix();
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  Transform cam0_from_velo = Transform::Identity(), rect = Transform::Identity();
  cam0_from_velo.linear() = Eigen::AngleAxisd(0.015, Vec3d(1, 2, 3).normalized()).matrix() * axes;
  cam0_from_velo.translation() = Vec3d(-0.004, -0.076, -0.27);
  rect.linear() = c.rect_from_cam0;
  c.camera_from_velo = c.camera_from_rect * rect * cam0_from_velo;
  return c;
}

std::vector<KittiDetection> made_up(int count) {
  RandomStream random(3, "results");
  std::vector<KittiDetection> found;
  for (int i = 0; i < count; ++i) {
    KittiDetection one;
    one.box = Box3{{random.uniform(5, 60), random.uniform(-15, 15), random.uniform(3, 6),
                    random.uniform(1.4, 2), random.uniform(-std::numbers::pi, std::numbers::pi)},
                   random.uniform(-2, -1),
                   random.uniform(1.3, 2)};
    one.score = random.uniform();
    found.push_back(one);
  }
  return found;
}

TEST(KittiResults, WhatIsWrittenIsReadBack) {
  const TemporaryFolder folder;
  const auto found = made_up(200);
  write_results(folder / "000007.txt", found, calibration());
  const auto back = read_results(folder / "000007.txt", calibration());
  ASSERT_EQ(back.size(), found.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    const Box3 &a = *found[i].box, &b = back[i].box.value();
    for (const auto& [was, is] : {std::pair(a.bev.x, b.bev.x),
                                  {a.bev.y, b.bev.y},
                                  {a.bev.length, b.bev.length},
                                  {a.bev.width, b.bev.width},
                                  {a.bottom, b.bottom},
                                  {a.height, b.height}})
      EXPECT_NEAR(was, is, 2e-6) << i;
    EXPECT_NEAR(std::remainder(a.bev.yaw - b.bev.yaw, 2 * std::numbers::pi), 0, 2e-6) << i;
    EXPECT_NEAR(found[i].score, back[i].score, 1e-11);
    EXPECT_EQ(back[i].type, "Car");
  }
}

TEST(KittiResults, RowsAreThoseOfTheDevelopmentKit) {
  const TemporaryFolder folder;
  write_results(folder / "a.txt", made_up(1), calibration());
  std::istringstream row(read_file(folder / "a.txt"));
  std::string type;
  std::vector<double> values;
  row >> type;
  for (double value; row >> value;) values.push_back(value);
  EXPECT_EQ(type, "Car");
  ASSERT_EQ(values.size(), 15u);
  EXPECT_EQ(values[0], -1);
  EXPECT_EQ(values[1], -1);
  const double alpha = values[2], x = values[10], z = values[12], ry = values[13];
  EXPECT_NEAR(std::remainder(ry - std::atan2(x, z) - alpha, 2 * std::numbers::pi), 0, 1e-5);
  EXPECT_GT(z, 0);
  // The same rows as labels give the same box: both are KITTI's.
  const auto labels = read_labels(folder / "a.txt", calibration());
  EXPECT_NEAR(labels.at(0).box.bev.x, made_up(1)[0].box->bev.x, 2e-6);
}

TEST(KittiResults, ABoxOfThePictureAloneHasNoPlace) {
  const TemporaryFolder folder;
  KittiDetection one;
  one.picture = {12.5, 30, 80.25, 99};
  one.score = 0.5;
  write_results(folder / "a.txt", std::vector{one}, calibration());
  EXPECT_THAT(read_file(folder / "a.txt"), HasSubstr("-1 -1 -1 -1000 -1000 -1000 -10 0.5"));
  const auto back = read_results(folder / "a.txt", calibration());
  ASSERT_EQ(back.size(), 1u);
  EXPECT_FALSE(back[0].box);
  EXPECT_EQ(back[0].picture->right, 80.25);
}

TEST(KittiResults, TheProjectionHoldsWhatTheCameraSees) {
  const Calibration c = calibration();
  const Box3 ahead{{20, 0, 4, 1.8, 0.3}, -1.7, 1.5};
  const PictureBox whole = projected(ahead, c).value();
  for (const Vec3d& corner : corners(ahead)) {
    const Vec2d p = c.camera.project(Vec3d(c.camera_from_velo * corner));
    EXPECT_TRUE(p.x() >= whole.left - 1e-9 && p.x() <= whole.right + 1e-9 && p.y() >= whole.top - 1e-9 &&
                p.y() <= whole.bottom + 1e-9);
  }
  // Half behind the camera: clipped there, and at the picture's edges.
  const PictureBox cut = projected({{0.5, 2, 4, 1.8, 0}, -1.7, 1.5}, c).value();
  EXPECT_EQ(cut.left, 0);
  EXPECT_EQ(cut.bottom, 374);
  EXPECT_FALSE(projected({{-20, 0, 4, 1.8, 0}, -1.7, 1.5}, c));
  EXPECT_FALSE(projected({{5, 40, 4, 1.8, 0}, -1.7, 1.5}, c));
}

TEST(KittiResults, OtherPeoplesFiles) {
  const TemporaryFolder folder;
  write_file(folder / "a.txt",
             "Pedestrian -1 -1 0.2 -4.1 100 50 400.7 1.7 0.6 0.8 1.5 1.6 12 0.3 -3.25\r\n\n"
             "DontCare -1 -1 -10 5 5 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n");
  const auto found = read_results(folder / "a.txt", calibration());
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].type, "Pedestrian");
  EXPECT_EQ(found[0].score, -3.25);
  write_file(folder / "none.txt", "");
  EXPECT_TRUE(read_results(folder / "none.txt", calibration()).empty());
}

TEST(KittiResults, BadRowsAreNamed) {
  const TemporaryFolder folder;
  for (const auto& [row, word] :
       {std::pair("Car -1 -1 0 1 1 2 2 1.5 1.6 4 1 1.6 12 0.3 nan", "row 1, score"),
        {"Car -1 -1 0 1 1 2 2 1.5 1.6 400 1 1.6 12 0.3 1", "row 1, length"},
        {"Car -1 -1 0 1 1 2 2 1.5 1.6 4 1 1.6 12000 0.3 1", "row 1, z"},
        {"Car -1 -1 0 1 1 2 2 1.5 1.6 4 1 1.6 twelve 0.3 1", "row 1, z"},
        {"Car -1 -1 0 1 1 2 2 1.5", "9 columns"},
        {"Car -1 -1 0 0 0 0 0 -1 -1 -1 -1000 -1000 -1000 -10 1", "2-D box is empty"}}) {
    write_file(folder / "bad.txt", row);
    EXPECT_THAT(error_text<InputError>([&] { read_results(folder / "bad.txt", calibration()); }),
                AllOf(HasSubstr("bad.txt"), HasSubstr(word)));
  }
}

}  // namespace
}  // namespace mirage
