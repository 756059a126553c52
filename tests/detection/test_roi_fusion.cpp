// Things compared with a picture network's boxes (detection/roi_fusion.h).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "detection/roi_fusion.h"
#include "scene/data/kitti_rows.h"
#include "support/files.h"
#include "support/scripted_detector.h"

namespace mirage {
namespace {

using test::Script;
using test::Scripted;
using ::testing::HasSubstr;

constexpr int kFirstType = 0, kOtherType = 1;

/// A camera that looks ahead, a detector of things and a picture network.
struct FusedScene {
  ImageF image{1242, 375, 3};
  std::vector<LidarPoint> points{{5, 0, 0, 0}};
  Calibration calibration;
  Script things, picture;

  FusedScene() {
    calibration.camera = {721, 721, 609, 172, 1242, 375};
    calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  }
  SensorView view() const { return {&image, points, &calibration}; }
  /// A thing at that place, with the plugin's type.
  Detection& add(const BevBox& box, int type, double logit) {
    Detection thing(box, logit);
    thing.box.bottom = -1.7, thing.box.height = 1.5;
    thing.type = type;
    things.lines.push_back({thing});
    return things.lines.back().proposal;
  }
  /// Adds the picture network's box around a box in space.
  void see(const Box3& box, double logit) {
    picture.lines.push_back({Detection({}, logit, projected(box, calibration).value())});
  }
  std::unique_ptr<Detector> detector() {
    Capabilities can, seen;
    can.reads_image = can.has_gradients = seen.reads_points = seen.finds_bev = false;
    can.finds_heights = seen.finds_picture = true;
    can.types = {"Car", "Misc"};
    return with_picture(std::make_unique<Scripted>("things", can, things),
                        std::make_unique<Scripted>("picture", seen, picture));
  }
  std::vector<Detection> found(double score = 1e-4) { return detector()->forward(view(), score, false); }
};

const BevBox kAhead{20, 2, 4, 1.7, 0.1}, kBeside{15, -6, 0.6, 0.6, 0}, kBehind{-20, 2, 4, 1.7, 0};

TEST(RoiFusion, WhatThePictureShowsRaisesACarAndElseItSinks) {
  FusedScene scene;
  const Box3 car = scene.add(kAhead, kFirstType, 0.5).box;
  EXPECT_DOUBLE_EQ(scene.found()[0].logit, 0.5 + kUnseenLogit);
  scene.see(car, 1.5);
  EXPECT_DOUBLE_EQ(scene.found()[0].logit, 2.0);
  scene.picture.lines[0].proposal.logit = -5;  // seen, but with too low a score to count
  EXPECT_DOUBLE_EQ(scene.found()[0].logit, 0.5 + kUnseenLogit);
  EXPECT_TRUE(scene.found(0.5).empty());
  scene.picture.lines[0].proposal.logit = 3;
  EXPECT_EQ(scene.found(0.9).size(), 1u);  // below the threshold before
  scene.picture.lines[0].proposal.picture.right += 400;
  EXPECT_DOUBLE_EQ(scene.found()[0].logit, 0.5 + kUnseenLogit);  // another thing's box
}

TEST(RoiFusion, WhatTheCameraDoesNotSeeStaysAsItIs) {
  FusedScene scene;
  scene.add(kBehind, kFirstType, 0.5);
  EXPECT_EQ(scene.found()[0].logit, 0.5);
  scene.add(kAhead, kFirstType, 0.7);
  const auto blind = scene.detector()->forward({nullptr, scene.points, &scene.calibration}, 1e-4, false);
  ASSERT_EQ(blind.size(), 2u);
  EXPECT_EQ(blind[1].logit, 0.7);
}

TEST(RoiFusion, AThingThatThePictureCallsACarIsOne) {
  FusedScene scene;
  const Box3 van = scene.add(kAhead, kOtherType, 2).box;
  scene.add(kBeside, kOtherType, 1);
  auto found = scene.found();
  ASSERT_EQ(found.size(), 2u);  // neither has support
  EXPECT_EQ(found[0].logit, 2);
  scene.see(van, 1);
  found = scene.found();
  ASSERT_EQ(found.size(), 3u);
  EXPECT_EQ(found[1].logit, 1);  // a cone is unchanged
  EXPECT_EQ(found[2].type, kFirstType);
  EXPECT_EQ(found[2].logit, 1);
  EXPECT_EQ(found[2].box.bev.x, kAhead.x);
  const auto sigmoid = [](double x) { return 1 / (1 + std::exp(-x)); };
  EXPECT_NEAR(found[0].score(), sigmoid(2) * (1 - sigmoid(1)), 1e-9);
  scene.add(kAhead, kFirstType, -1);  // the plugin says so itself
  EXPECT_EQ(scene.found().size(), 3u);
  scene.picture.lines[0].proposal.logit = 60;  // as sure as numbers are
  for (const Detection& one : scene.found(-1)) EXPECT_TRUE(std::isfinite(one.logit));
}

TEST(RoiFusion, ReadsBothSensorsAndHasNoGradient) {
  FusedScene scene;
  const auto detector = scene.detector();
  EXPECT_TRUE(detector->capabilities().reads_image && detector->capabilities().reads_points);
  EXPECT_FALSE(detector->capabilities().has_gradients);
  EXPECT_EQ(detector->name(), "things");
  EXPECT_TRUE(detector->share());
}

TEST(RoiFusion, ANetworkThatFindsNothingInThePictureIsRefused) {
  FusedScene scene;
  Capabilities from_above;
  EXPECT_THAT(test::error_text<InputError>([&] {
                with_picture(scene.detector(),
                             std::make_unique<Scripted>("lidar", from_above, scene.picture));
              }),
              HasSubstr("weights"));
  EXPECT_EQ(picture_network("a/yolo.onnx"), "onnx");
  EXPECT_EQ(picture_network("yolo.pt"), "torchscript");
  EXPECT_EQ(picture_network("camera-kitti64.weights"), "camera");
}

}  // namespace
}  // namespace mirage
