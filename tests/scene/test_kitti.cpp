#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/random.h"
#include "base/sizes.h"
#include "scene/data/data_rig.h"
#include "scene/data/data_set.h"
#include "scene/data/kitti.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/heard.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

// A frame with all of KITTI's offsets: a tilted rectification and a colour camera beside camera 0.
Frame small_frame() {
  Frame frame;
  frame.id = "000042";
  frame.image = ImageF(124, 38, 3, 0.25f);
  frame.image.at(3, 2, 1) = 1;
  auto& c = frame.calibration;
  c.camera = {72.15377, 72.15377, 60.95593, 17.2854, 124, 38};
  c.camera_from_rect.translation() = Vec3d(0.06, -0.0003, 0.0027);
  c.rect_from_cam0 =
      (Eigen::AngleAxisd(0.01, Vec3d::UnitY()) * Eigen::AngleAxisd(-0.007, Vec3d::UnitX())).matrix();
  Transform cam0_from_velo = Transform::Identity();
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  cam0_from_velo.linear() = Eigen::AngleAxisd(0.015, Vec3d(1, 2, 3).normalized()).matrix() * axes;
  cam0_from_velo.translation() = Vec3d(-0.004, -0.076, -0.27);
  Transform rect = Transform::Identity();
  rect.linear() = c.rect_from_cam0;
  c.camera_from_velo = c.camera_from_rect * rect * cam0_from_velo;
  RandomStream random(1, "kitti test");
  for (int i = 0; i < 50; ++i)
    frame.sweep.push_back({static_cast<float>(random.uniform(2, 70)),
                           static_cast<float>(random.uniform(-20, 20)),
                           static_cast<float>(random.uniform(-2, 1)), static_cast<float>(random.uniform())});
  for (int i = 0; i < 12; ++i) {
    Label label;
    label.type = i % 3 ? "Car" : "Van";
    label.truncated = 0.25;
    label.occluded = i % 4;
    label.left = 10, label.top = 5, label.right = 60.5, label.bottom = 36.25;
    label.box = {{random.uniform(5, 60), random.uniform(-15, 15), random.uniform(3, 6),
                  random.uniform(1.4, 2), random.uniform(-std::numbers::pi, std::numbers::pi)},
                 random.uniform(-2, -1),
                 random.uniform(1.3, 2)};
    frame.labels.push_back(label);
  }
  Label ignored;
  ignored.type = "DontCare";
  ignored.right = ignored.bottom = 20;
  frame.labels.push_back(ignored);
  frame.lighting.to_sun_velo = Vec3d(0.1, -0.7, 0.6).normalized();
  frame.lighting.sun = Vec3d(0.9, 0.8, 0.7);
  return frame;
}

class Kitti : public testing::Test {
 protected:
  void SetUp() override { write_frame(folder_.path(), small_frame()); }
  std::filesystem::path file(const std::string& name) const { return folder_.path() / "training" / name; }
  void replace(const std::string& name, const std::string& from, const std::string& to) const {
    std::string text = read_file(file(name));
    const auto place = text.find(from);
    ASSERT_NE(place, std::string::npos) << from;
    write_file(file(name), text.replace(place, from.size(), to));
  }
  std::string reading_fails() const {
    return error_text<InputError>([&] { read_frame(folder_.path(), "000042"); });
  }
  TemporaryFolder folder_;
};

TEST_F(Kitti, FrameSurvivesWritingAndReading) {
  const Frame before = small_frame(), after = read_frame(folder_.path(), "000042");
  EXPECT_EQ(list_frames(folder_.path()), std::vector<std::string>{"000042"});
  ASSERT_EQ(after.sweep.size(), before.sweep.size());
  for (std::size_t i = 0; i < before.sweep.size(); ++i) {
    EXPECT_EQ(after.sweep[i].position(), before.sweep[i].position());
    EXPECT_EQ(after.sweep[i].reflectance, before.sweep[i].reflectance);
  }
  EXPECT_EQ(after.image.width, 124);
  EXPECT_NEAR(after.image.at(3, 2, 0), 0.25, 0.005);
  EXPECT_EQ(after.image.at(3, 2, 1), 1);
  EXPECT_TRUE(after.calibration.camera_from_velo.isApprox(before.calibration.camera_from_velo, 1e-9));
  EXPECT_TRUE(after.calibration.camera_from_rect.isApprox(before.calibration.camera_from_rect, 1e-9));
  EXPECT_NEAR(after.calibration.camera.fx, before.calibration.camera.fx, 1e-9);
  EXPECT_TRUE(after.lighting.to_sun_velo.isApprox(before.lighting.to_sun_velo, 1e-12));
  EXPECT_EQ(after.lighting.sun, before.lighting.sun);
  ASSERT_EQ(after.labels.size(), before.labels.size());
  for (std::size_t i = 0; i < before.labels.size(); ++i) {
    const Label &a = after.labels[i], &b = before.labels[i];
    EXPECT_EQ(a.type, b.type);
    EXPECT_NEAR(a.right, b.right, 0.005);
    if (b.type == "DontCare") continue;
    EXPECT_EQ(a.occluded, b.occluded);
    EXPECT_NEAR(a.box.bev.x, b.box.bev.x, 3e-6);
    EXPECT_NEAR(a.box.bev.y, b.box.bev.y, 3e-6);
    EXPECT_NEAR(a.box.bottom, b.box.bottom, 3e-6);
    EXPECT_NEAR(a.box.bev.length, b.box.bev.length, 1e-6);
    EXPECT_NEAR(a.box.bev.width, b.box.bev.width, 1e-6);
    EXPECT_NEAR(a.box.height, b.box.height, 1e-6);
    EXPECT_NEAR(std::remainder(a.box.bev.yaw - b.box.bev.yaw, 2 * std::numbers::pi), 0, 3e-6);
  }
}

TEST_F(Kitti, WithoutLightingTheDefaultIsUsed) {
  std::filesystem::remove(file("lighting/000042.json"));
  EXPECT_EQ(read_frame(folder_.path(), "000042").lighting.sun, Lighting().sun);
}

// With aligned axes, ry and yaw are related by hand: KITTI's ry = 0 is a heading along the camera's +x, which
// is −y of velo.
TEST(KittiLabels, HeadingsByHand) {
  TemporaryFolder folder;
  Calibration calibration;
  calibration.camera = {700, 700, 600, 180, 1242, 375};
  calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  calibration.camera_from_velo.translation() = Vec3d(0.06, -0.08, -0.27);
  calibration.camera_from_rect.translation() = Vec3d(0.06, 0, 0);
  write_file(folder / "l.txt",
             "Car 0.00 0 0 100 100 200 200 1.5 1.6 3.9 2 1.7 20 0\n"
             "Car 0.00 0 0 100 100 200 200 1.5 1.6 3.9 2 1.7 20 -1.5707963267948966\n"
             "Car 0.00 0 0 100 100 200 200 1.5 1.6 3.9 2 1.7 20 0.3\n");
  const auto labels = read_labels(folder / "l.txt", calibration);
  ASSERT_EQ(labels.size(), 3u);
  EXPECT_NEAR(labels[0].box.bev.yaw, -std::numbers::pi / 2, 1e-12);
  EXPECT_NEAR(labels[1].box.bev.yaw, 0, 1e-12);
  EXPECT_NEAR(labels[2].box.bev.yaw, -std::numbers::pi / 2 - 0.3, 1e-12);
  // rect (2, 1.7, 20) → velo (z, −x, −y) less the translation between rect and velo.
  EXPECT_NEAR(labels[0].box.bev.x, 20.27, 1e-12);
  EXPECT_NEAR(labels[0].box.bev.y, -2, 1e-12);
  EXPECT_NEAR(labels[0].box.bottom, -1.78, 1e-12);
}

TEST(KittiCalibration, FoldsP2sFourthColumnIntoThePose) {
  TemporaryFolder folder;
  write_file(folder / "c.txt",
             "P2: 700 0 600 45 0 710 180 0.2 0 0 1 0.003\n"
             "R0_rect: 0.9999500004 -0.0099998333 0 0.0099998333 0.9999500004 0 0 0 1\n"
             "Tr_velo_to_cam: 0 -1 0 -0.004 0 0 -1 -0.076 1 0 0 -0.27\n");
  const Calibration c = read_calibration(folder / "c.txt", 1242, 375);
  Eigen::Matrix<double, 3, 4> p2;
  p2 << 700, 0, 600, 45, 0, 710, 180, 0.2, 0, 0, 1, 0.003;
  Eigen::Matrix4d r0 = Eigen::Matrix4d::Identity(), tr = Eigen::Matrix4d::Identity();
  r0.topLeftCorner<3, 3>() << 0.9999500004, -0.0099998333, 0, 0.0099998333, 0.9999500004, 0, 0, 0, 1;
  tr.topRows<3>() << 0, -1, 0, -0.004, 0, 0, -1, -0.076, 1, 0, 0, -0.27;
  for (const Vec3d& p : {Vec3d(10, 1, -1), Vec3d(40, -12, 0.5)}) {
    const Vec3d projected = p2 * (r0 * tr * p.homogeneous());
    const Vec2d pixel = c.camera.project<double>(c.camera_from_velo * p);
    EXPECT_NEAR(pixel.x(), projected.x() / projected.z(), 1e-5);
    EXPECT_NEAR(pixel.y(), projected.y() / projected.z(), 1e-5);
  }
}

TEST_F(Kitti, MissingFolderAndEmptyFolder) {
  TemporaryFolder empty;
  EXPECT_THAT(error_text<InputError>([&] { list_frames(empty.path()); }), HasSubstr("holds nothing"));
  std::filesystem::create_directories(empty.path() / "training" / "velodyne");
  EXPECT_THAT(error_text<InputError>([&] { list_frames(empty.path()); }), HasSubstr("no .bin"));
}

TEST_F(Kitti, EachMissingFileIsNamed) {
  for (const char* name : {"velodyne/000042.bin", "image_2/000042.png", "calib/000042.txt"}) {
    const std::string kept = read_file(file(name));
    std::filesystem::remove(file(name));
    EXPECT_THAT(reading_fails(), AllOf(HasSubstr(name), HasSubstr("missing")));
    write_file(file(name), kept);
  }
}

TEST_F(Kitti, BrokenSweeps) {
  const std::string good = read_file(file("velodyne/000042.bin"));
  write_file(file("velodyne/000042.bin"), good.substr(0, good.size() - 5));
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("000042.bin"), HasSubstr("byte 784"), HasSubstr("truncated")));
  write_file(file("velodyne/000042.bin"), "");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("000042.bin"), HasSubstr("empty")));
  Sweep sweep = small_frame().sweep;
  sweep[7].y = 2e3f;
  write_sweep(file("velodyne/000042.bin"), sweep);
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("000042.bin"), HasSubstr("point 7 (byte 112)")));
}

TEST_F(Kitti, BrokenCalibration) {
  const std::string good = read_file(file("calib/000042.txt"));
  const auto with = [&](const std::string& row, const std::string& text) {
    std::string changed;
    std::size_t from = 0;
    for (std::size_t end; (end = good.find('\n', from)) != std::string::npos; from = end + 1)
      if (const std::string line = good.substr(from, end - from); line.starts_with(row + ":"))
        changed += text;
      else
        changed += line + "\n";
    write_file(file("calib/000042.txt"), changed);
    return reading_fails();
  };
  for (const char* row : {"P2", "R0_rect", "Tr_velo_to_cam"}) {
    EXPECT_THAT(with(row, ""),
                AllOf(HasSubstr("calib/000042.txt"), HasSubstr(row), HasSubstr("row missing")));
    EXPECT_THAT(with(row, std::string(row) + ": 1 2 3\n"),
                AllOf(HasSubstr(row), HasSubstr("3 numbers where")));
  }
  EXPECT_THAT(with("P2", "P2: 72 0 x 0 0 72 17 0 0 0 1 0\n"), HasSubstr("P2, number 3: 'x' is not a number"));
  EXPECT_THAT(with("P2", "P2: 72 0 nan 0 0 72 17 0 0 0 1 0\n"), HasSubstr("not finite"));
  EXPECT_THAT(with("P2", "P2: 72 0 600 0 0 72 17 0 0 0 1 0\n"),
              HasSubstr("far from the middle of the 124x38 image"));
  // A picture at half the size of its calibration's.
  EXPECT_THAT(with("P2", "P2: 144 0 120 0 0 144 34 0 0 0 1 0\n"), HasSubstr("far from the middle"));
  EXPECT_THAT(with("P2", "P2: -72 0 60 0 0 72 17 0 0 0 1 0\n"), HasSubstr("P2"));
  EXPECT_THAT(with("R0_rect", "R0_rect: 1 0 0 0 1 0 0 0 -1\n"), HasSubstr("R0_rect: is not a rotation"));
  EXPECT_THAT(with("Tr_velo_to_cam", "Tr_velo_to_cam: 0 -1 0 500 0 0 -1 0 1 0 0 0\n"), HasSubstr("metres"));
}

TEST_F(Kitti, BrokenLabels) {
  const auto with = [&](const std::string& row) {
    write_file(file("label_2/000042.txt"), "Car 0 0 0 1 1 9 9 1.5 1.6 3.9 2 1.7 20 0.1\n" + row + "\n");
    return reading_fails();
  };
  const std::string where = "label_2/000042.txt: row 2";
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6"), AllOf(HasSubstr(where), HasSubstr("10 columns")));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 nan 3.9 2 1.7 20 0"), AllOf(HasSubstr(where), HasSubstr("width")));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6 3.9 2 1.7 inf 0"), AllOf(HasSubstr(where), HasSubstr("z: ")));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6 3.9 2 1.7 20m 0"), HasSubstr("'20m' is not a number"));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6 3.9 5000 1.7 20 0"),
              AllOf(HasSubstr("x: "), HasSubstr("1 km")));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 0 1.6 3.9 2 1.7 20 0"), HasSubstr("height: 0"));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6 99 2 1.7 20 0"), HasSubstr("length: 99"));
  EXPECT_THAT(with("Car 0 0 0 0 0 0 0 0 0 0 0 0 0 0"),
              AllOf(HasSubstr(where), HasSubstr("2-D box is empty")));
  EXPECT_THAT(with("Car 0 0 0 9 1 2 9 1.5 1.6 3.9 2 1.7 20 0"), HasSubstr("right: 2 is left of"));
  EXPECT_THAT(with("Car 0 7 0 1 1 9 9 1.5 1.6 3.9 2 1.7 20 0"), HasSubstr("occluded: 7"));
  EXPECT_THAT(with("Car 3 0 0 1 1 9 9 1.5 1.6 3.9 2 1.7 20 0"), HasSubstr("truncated: 3"));
  EXPECT_THAT(with("Car 0 0 0 1 1 9 9 1.5 1.6 3.9 2 1.7 20 90"), HasSubstr("rotation_y: 90"));
}

/// Row names of KITTI, of another benchmark and of other writers, and ambiguous combinations.
TEST_F(Kitti, CalibrationRowsByTheirOtherNames) {
  const std::string good = read_file(file("calib/000042.txt"));
  const Frame meant = read_frame(folder_.path(), "000042");
  const auto edit = [&](std::initializer_list<std::pair<std::string, std::string>> edits) {
    std::string text = good;
    for (const auto& [from, to] : edits) text.replace(text.find(from), from.size(), to);
    write_file(file("calib/000042.txt"), text);
  };
  const auto expect_same = [&] {
    EXPECT_EQ(read_frame(folder_.path(), "000042").calibration.camera_from_velo.matrix(),
              meant.calibration.camera_from_velo.matrix());
  };
  edit({{"R0_rect:", "R_rect"}, {"Tr_velo_to_cam:", "Tr_velo_cam"}, {"Tr_imu_to_velo:", "Tr_imu_velo"}});
  expect_same();
  edit({{"R0_rect: ", "R_rect:"}, {"P2: ", "P2:"}});
  expect_same();
  edit({{"P2: ", "P2 :\t"}});
  expect_same();
  write_file(file("calib/000042.txt"), "\xef\xbb\xbf" + good.substr(good.find("P2:")));
  expect_same();
  write_file(file("calib/000042.txt"), good + "P2: 71 0 60 0 0 71 17 0 0 0 1 0\n");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("calib/000042.txt: P2"), HasSubstr("2 times")));
  write_file(file("calib/000042.txt"), good + "R_rect: 1 0 0 0 1 0 0 0 1\n");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("R0_rect, R_rect"), HasSubstr("2 times")));
}

/// Labels as KITTI's development kit writes them, and as SUSTech POINTS, CVAT and nuScenes' exporter do.
TEST_F(Kitti, LabelsOfOtherWriters) {
  const auto read = [&](const std::string& text) {
    write_file(file("label_2/000042.txt"), text);
    return read_annotations(folder_.path(), "000042");
  };
  const std::string box = " 0 0 0 10 5 60 30 1.5 1.6 3.9 2 1.7 20 0.1";
  const std::map<std::string, std::string> types = {{"car", "Car"},
                                                    {"CAR", "Car"},
                                                    {"dontcare", "DontCare"},
                                                    {"vehicle.car", "Car"},
                                                    {"vehicle.bus.rigid", "Bus"},
                                                    {"human.pedestrian.adult", "Pedestrian"},
                                                    {"movable_object.trafficcone", "Misc"},
                                                    {"TYPE_VEHICLE", "Car"},
                                                    {"REGULAR_VEHICLE", "Car"},
                                                    {"LARGE_VEHICLE", "Truck"},
                                                    {"VEHICLE", "Car"},
                                                    {"vehicle.foo", "vehicle.foo"},
                                                    {"Golem", "Golem"}};
  for (const auto& [name, type] : types) {
    EXPECT_EQ(read(name + box + " 0.9\r\n").labels.at(0).type, type);
    EXPECT_EQ(is_known_type(name), type != name || type == "Car");
  }
  EXPECT_EQ(read("\xef\xbb\xbf"
                 "Car" +
                 box)
                .labels.at(0)
                .type,
            "Car");
  EXPECT_THAT(error_text<InputError>([&] {
                read(
                    "\xff\xfe"
                    "C\0a\0r\0");
              }),
              AllOf(HasSubstr("label_2/000042.txt"), HasSubstr("UTF-16")));
}

/// Boxes in the picture by hand: boxes beyond 124 × 38 pixels are clipped, missing ones are projected.
TEST_F(Kitti, BoxesInThePictureAreClippedOrProjected) {
  const auto read = [&](const std::string& picture, const std::string& space = "1.5 1.6 3.9 2 1.7 20 0.1") {
    write_file(file("label_2/000042.txt"), "Car 0 0 0 " + picture + " " + space + "\n");
    return read_annotations(folder_.path(), "000042");
  };
  const auto expect_box = [](const Label& label, std::array<double, 4> box) {
    EXPECT_THAT((std::array{label.left, label.top, label.right, label.bottom}),
                testing::ElementsAreArray(box));
  };
  Annotations known = read("-31.2 1 200 401.5");
  expect_box(known.labels[0], {0, 1, 123, 37});
  EXPECT_EQ(known.notes.clipped, 1);
  EXPECT_EQ(known.notes.projected, 0);
  known = read("-0.5 1 123.7 30");  // beyond it by rounding only, as in KITTI's files
  expect_box(known.labels[0], {-0.5, 1, 123.7, 30});
  EXPECT_EQ(known.notes.clipped, 0);
  for (const char* none : {"0 0 0 0", "-1 -1 -1 -1", "50 20 50 30", "500 1 600 30"}) {
    known = read(none);
    const PictureBox seen = *projected(known.labels[0].box, known.calibration);
    expect_box(known.labels[0], {seen.left, seen.top, seen.right, seen.bottom});
    EXPECT_GT(seen.right, seen.left);
    EXPECT_EQ(known.notes.projected, 1);
  }
  // Nothing is visible behind the camera; the label keeps its index in the frame.
  expect_box(read("0 0 0 0", "1.5 1.6 3.9 2 1.7 -20 0.1").labels.at(0), {0, 0, 0, 0});
  for (const char* none : {"0 0 0 0 0 0 0", "-1 -1 -1 -1000 -1000 -1000 -10"}) {
    known = read("10 5 60 30", none);
    EXPECT_FALSE(has_box(known.labels.at(0)));
    write_labels(file("label_2/000042.txt"), known.labels, known.calibration);
    const Label again = read_annotations(folder_.path(), "000042").labels.at(0);
    EXPECT_FALSE(has_box(again));
    expect_box(again, {10, 5, 60, 30});
  }
}

TEST_F(Kitti, LabelsAreCountedAndTheirAbsenceIsSaid) {
  const std::vector<std::string> ids = {"000042"};
  const auto census = [&] { return count_labels(folder_.path(), ids); };
  const auto refused = [&] { return error_text<InputError>([&] { require_cars(census(), "an attack"); }); };
  LabelCensus counted = census();
  EXPECT_EQ(counted.labels, 12);
  EXPECT_EQ(counted.cars, 8);
  EXPECT_EQ(counted.unlabelled, 0u);
  EXPECT_NO_THROW(require_cars(counted, "an attack"));
  const std::vector<std::string> trucks = {"Truck"}, vans = {"Van"};
  EXPECT_NO_THROW(require_types(counted, vans, "--types"));
  EXPECT_THAT(error_text<InputError>([&] { require_types(counted, trucks, "--types"); }),
              AllOf(HasSubstr("--types: Truck"), HasSubstr("8 Car, 4 Van")));
  std::string text = read_file(file("label_2/000042.txt"));
  for (const char* type : {"Car", "Van"})
    for (std::size_t at = 0; (at = text.find(type, at)) != std::string::npos && text[at + 3] == ' ';)
      text.replace(at, 3, "vehicle.foo"), at += 11;
  write_file(file("label_2/000042.txt"), text);
  EXPECT_THAT(refused(), AllOf(HasSubstr("0 of 12"), HasSubstr("12 vehicle.foo"), HasSubstr("Waymo")));
  write_file(file("label_2/000042.txt"), "Car 0 0 0 10 5 60 30 0 0 0 0 0 0 0\n");
  EXPECT_THAT(refused(), AllOf(HasSubstr("all 1 cars"), HasSubstr("in the picture alone")));
  write_file(file("label_2/000042.txt"), "");
  EXPECT_THAT(refused(), HasSubstr("hold no object"));
  std::filesystem::remove(file("label_2/000042.txt"));
  EXPECT_EQ(census().unlabelled, 1u);
  EXPECT_THAT(refused(), AllOf(HasSubstr("none of the 1 frames has any"), HasSubstr("--hosts-from")));
}

TEST_F(Kitti, PicturesMayBeJpegsAndFramesWithoutLabels) {
  std::filesystem::rename(file("image_2/000042.png"),
                          file("image_2/000042.JPG"));  // its content shows the format
  EXPECT_EQ(read_frame(folder_.path(), "000042").image.width, 124);
  std::filesystem::remove_all(file("label_2"));
  const Frame frame = read_frame(folder_.path(), "000042");
  EXPECT_FALSE(frame.labelled);
  EXPECT_TRUE(frame.labels.empty());
  const std::string unlabelled = open_data_set(folder_.path())->hash("000042");
  write_file(file("label_2/000042.txt"), "");
  EXPECT_TRUE(read_frame(folder_.path(), "000042").labelled);
  EXPECT_NE(open_data_set(folder_.path())->hash("000042"), unlabelled);
  std::filesystem::remove_all(file("label_2"));
  std::filesystem::rename(folder_ / "training", folder_ / "testing");
  EXPECT_EQ(read_frame(folder_.path(), "000042").sweep.size(), 50u);
}

/// Labels of a detector beside a set: the set's frames with these labels, whatever the folder is called.
TEST_F(Kitti, GivenLabelsStandForMissingOnes) {
  const Frame whole = read_frame(folder_.path(), "000042");
  std::filesystem::remove_all(file("label_2"));
  const auto given = folder_ / "given";
  write_file(folder_ / "dataset.json", R"({"rig": "xenith"})");
  write_labels(given / "label_2/000042.txt", whole.labels, whole.calibration);
  write_separate_labels(given, folder_.path(), {{"score", 0.3}});
  const Frame frame = read_frame(given, "000042");
  EXPECT_TRUE(frame.labelled);
  EXPECT_EQ(frame.labels.size(), whole.labels.size());
  EXPECT_EQ(frame.sweep.size(), whole.sweep.size());
  EXPECT_EQ(frame.image.data, whole.image.data);
  EXPECT_EQ(data_rig(given), "xenith");
  EXPECT_NE(open_data_set(given)->hash("000042"), open_data_set(folder_.path())->hash("000042"));
  write_file(given / "labels.json", R"({"data": "/nowhere"})");
  EXPECT_THAT(error_text<InputError>([&] { list_frames(given); }),
              AllOf(HasSubstr("labels.json"), HasSubstr("/nowhere")));
}

TEST(NoLayout, SaysWhatIsThereAndWhatIsMeant) {
  const TemporaryFolder folder;
  const auto said = [&](const std::filesystem::path& data) {
    return error_text<InputError>([&] { list_frames(data); });
  };
  EXPECT_THAT(said(folder / "none"), HasSubstr("no such folder"));
  write_file(folder / "file", "");
  EXPECT_THAT(said(folder / "file"), HasSubstr("is a file"));
  EXPECT_THAT(said(folder.path()), AllOf(HasSubstr("none of the layouts"), HasSubstr("it holds file;")));
  for (const char* part : {"training", "testing", "drive_training"})
    std::filesystem::create_directories(folder / part / "velodyne");
  for (const char* part : {"training", "testing", "training/"})
    EXPECT_THAT(said(folder / part), HasSubstr("give its parent, " + folder.path().string()));
  EXPECT_THAT(said(folder / "drive_training"), HasSubstr("a folder called training"));
  std::filesystem::create_directories(folder / "x/training/image_2");
  EXPECT_THAT(said(folder / "x"), AllOf(HasSubstr("training/velodyne"), HasSubstr("sweeps")));
}

TEST_F(Kitti, IdentitiesAreReadWhereTheyAreKnown) {
  for (const Label& label : read_frame(folder_.path(), "000042").labels) EXPECT_EQ(label.track, -1);
  EXPECT_FALSE(open_data_set(folder_.path())->tracks("000042"));
  Frame frame = small_frame();
  for (std::size_t i = 0; i + 1 < frame.labels.size(); ++i)
    frame.labels[i].track = static_cast<int>(1000 + i);
  write_frame(folder_.path(), frame);
  const Frame after = read_frame(folder_.path(), "000042");
  for (std::size_t i = 0; i < frame.labels.size(); ++i)
    EXPECT_EQ(after.labels[i].track, frame.labels[i].track) << i;
  EXPECT_EQ(open_data_set(folder_.path())->tracks("000042")->size(), frame.labels.size());
}

TEST_F(Kitti, BrokenIdentities) {
  const auto file = folder_ / "training/track_2/000042.txt";
  write_file(file, "1004\n-1\n");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("track_2/000042.txt: 2 lines"), HasSubstr("13 labels")));
  write_file(file, "1004\nfour\n");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("row 2"), HasSubstr("'four' is not an identity")));
  write_file(file, "-2\n");
  EXPECT_THAT(reading_fails(), HasSubstr("'-2' is not an identity"));
  write_file(file, "");
  EXPECT_THAT(reading_fails(), HasSubstr("0 lines"));
}

TEST_F(Kitti, BrokenLightingAndImage) {
  const std::string name = "lighting/000042.json";
  write_file(file(name), "{\"sun\": [1, 1");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr(name), HasSubstr("byte")));
  write_file(file(name),
             R"({"to_sun_velo": [0, 0, 1], "sun": [1, 1], "ambient": [0, 0, 0], "hemisphere": [0, 0, 0]})");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr(name), HasSubstr("sun: not a list of 3")));
  write_file(
      file(name),
      R"({"to_sun_velo": [0, 0, 0], "sun": [1, 1, 1], "ambient": [0, 0, 0], "hemisphere": [0, 0, 0]})");
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr(name), HasSubstr("to_sun_velo")));
  const std::string picture = read_file(file("image_2/000042.png"));
  write_file(file("image_2/000042.png"), picture.substr(0, 20));
  EXPECT_THAT(reading_fails(), HasSubstr("image_2/000042.png"));
  // A picture that does not fit the calibration is refused by its header, before its pixels are decoded.
  write_srgb(file("image_2/000042.png"), ImageF(400, 380, 3, 0.5f));
  const std::string other = read_file(file("image_2/000042.png"));
  write_file(file("image_2/000042.png"), other.substr(0, 600));
  EXPECT_THAT(reading_fails(), AllOf(HasSubstr("calib/000042.txt"), HasSubstr("400x380")));
}

double overlap_with_2d_label(const Frame& frame, const Label& label) {
  double u0 = 1e9, u1 = -1e9, v0 = 1e9, v1 = -1e9;
  for (const Vec3d& p : corners(label.box)) {
    const Vec2d pixel = frame.calibration.camera.project<double>(frame.calibration.camera_from_velo * p);
    u0 = std::min(u0, pixel.x()), u1 = std::max(u1, pixel.x());
    v0 = std::min(v0, pixel.y()), v1 = std::max(v1, pixel.y());
  }
  u0 = std::max(u0, 0.0), v0 = std::max(v0, 0.0);
  u1 = std::min(u1, frame.image.width - 1.0), v1 = std::min(v1, frame.image.height - 1.0);
  const double both = std::max(0.0, std::min(u1, label.right) - std::max(u0, label.left)) *
                      std::max(0.0, std::min(v1, label.bottom) - std::max(v0, label.top));
  return both / ((u1 - u0) * (v1 - v0) + (label.right - label.left) * (label.bottom - label.top) - both);
}

TEST(KittiRealFrames, AllReadAndTheirBoxesProjectOntoTheir2dLabels) {
  MIRAGE_NEED_REAL_FRAMES();
  std::vector<double> overlaps;
  for (const std::string& id : list_frames(test::real_frames())) {
    const Frame frame = read_frame(test::real_frames(), id);
    EXPECT_GT(frame.sweep.size(), 50000u) << id;
    for (const Label& label : frame.labels)
      if (label.type != "DontCare" && label.truncated == 0)
        overlaps.push_back(overlap_with_2d_label(frame, label));
  }
  ASSERT_GT(overlaps.size(), 50u);
  std::sort(overlaps.begin(), overlaps.end());
  // The benchmark's own 2-D boxes are projections of its 3-D boxes: only rounding and clipping differ.
  EXPECT_GT(overlaps[overlaps.size() / 2], 0.985);
  EXPECT_GT(overlaps[overlaps.size() / 20], 0.95);
}

TEST(KittiRealFrames, LabelsAndCalibrationSurviveRewriting) {
  MIRAGE_NEED_REAL_FRAMES();
  TemporaryFolder folder;
  const std::string id = list_frames(test::real_frames()).back();
  const auto source = test::real_frames() / "training";
  const Calibration calibration = read_calibration(source / "calib" / (id + ".txt"), 1242, 375);
  const auto labels = read_labels(source / "label_2" / (id + ".txt"), calibration);
  write_calibration(folder / "c.txt", calibration);
  write_labels(folder / "l.txt", labels, calibration);
  const Calibration calibration2 = read_calibration(folder / "c.txt", 1242, 375);
  const auto labels2 = read_labels(folder / "l.txt", calibration2);
  EXPECT_TRUE(calibration2.camera_from_velo.isApprox(calibration.camera_from_velo, 1e-9));
  ASSERT_EQ(labels2.size(), labels.size());
  for (std::size_t i = 0; i < labels.size(); ++i) {
    if (labels[i].type == "DontCare") continue;
    EXPECT_NEAR(labels2[i].box.bev.x, labels[i].box.bev.x, 3e-6);
    EXPECT_NEAR(std::remainder(labels2[i].box.bev.yaw - labels[i].box.bev.yaw, 2 * std::numbers::pi), 0,
                3e-6);
  }
}

TEST(KittiSweep, WhatIsNoReturnIsLeftOutAndCounted) {
  const TemporaryFolder folder;
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  const Sweep good = {{1, 2, 3, 0.5f}, {4, 5, 6, 0.25f}};
  Sweep all = {{nan, nan, nan, nan}, good[0], {0, 0, 0, 0}, {inf, 1, 1, 0}, good[1], {1, 1, 1, nan}};
  write_sweep(folder / "000000.bin", all);
  write_sweep(folder / "000001.bin", all);
  const test::Heard heard;
  const Sweep read = read_sweep(folder / "000000.bin");
  ASSERT_EQ(read.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) EXPECT_EQ(read[i].position(), good[i].position());
  EXPECT_THAT(heard.text(), AllOf(HasSubstr("000000.bin"), HasSubstr("4 of 6 points")));
  EXPECT_EQ(read_sweep(folder / "000001.bin").size(), 2u);
  EXPECT_EQ(heard.warnings(), 1) << heard.text();  // once for the folder
  write_sweep(folder / "none.bin", {all[0], all[2]});
  EXPECT_THAT(error_text<InputError>([&] { read_sweep(folder / "none.bin"); }),
              HasSubstr("none is a return"));
}

// A file with another number of columns sometimes has a plausible size, and each of its values is finite.
TEST(KittiSweep, OtherNumbersOfFloatsAPointAreSeen) {
  const TemporaryFolder folder;
  const auto written = [&](int columns, bool shuffled) {
    RandomStream random(5, "columns");
    std::vector<float> values;
    for (int i = 0; i < 4000; ++i) {
      const double azimuth = shuffled ? random.uniform(0, 6) : 0.0015 * i,
                   range = 20 + 8 * std::sin(7 * azimuth);
      const std::array<double, 6> row = {range * std::cos(azimuth),   range * std::sin(azimuth),
                                         -1.5 + 0.01 * (i % 9),       columns == 4 ? 0.3 : 60.0 + i % 5,
                                         static_cast<double>(i % 32), 0.1};
      for (int k = 0; k < columns; ++k) values.push_back(static_cast<float>(row[as_size(k)]));
    }
    write_file(folder / "s.bin",
               {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)});
    return folder / "s.bin";
  };
  for (const bool shuffled : {false, true}) {
    EXPECT_EQ(read_sweep(written(4, shuffled)).size(), 4000u);
    for (const int columns : {5, 6})
      EXPECT_THAT(error_text<InputError>([&] { read_sweep(written(columns, shuffled)); }),
                  HasSubstr(std::to_string(columns) + " floats a point"));
  }
}

}  // namespace
}  // namespace mirage
