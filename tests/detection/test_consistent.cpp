// A fusion detector compared with the detections of each sensor alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "detection/car_in_picture.h"
#include "detection/consistent_detector.h"
#include "detection/defenses.h"
#include "support/files.h"
#include "support/scripted_detector.h"

namespace mirage {
namespace {

using test::error_text;
using test::Script;
using test::Scripted;

const Capabilities kFuses{true, true, true, false}, kLidar{false, true, true, false},
    kCamera{true, false, false, true};

/// A combined logit: the deciding member's, with a share kVoteLeak of the other's.
double soft(double decides, double other) {
  return (1 - kVoteLeak) * decides + kVoteLeak * other;
}

constexpr int kWidth = 124, kHeight = 38;

/// A tenth of KITTI's camera: it looks along x from 1.7 m above the ground.
struct Crossing {
  Crossing() {
    calibration.camera = {72, 72, 60, 18, kWidth, kHeight};
    Eigen::Matrix3d axes;
    axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    calibration.camera_from_velo.linear() = axes;
    image.data[0] = 0.5f;
  }
  SensorView view() const { return {&image, points, &calibration}; }
  /// The rectangle of a car on the ground in its picture.
  PictureBox seen(const BevBox& box) const {
    return *car_in_picture(box, -1.7, pixel_from_velo(calibration), kWidth, kHeight);
  }
  std::unique_ptr<Detector> detector() {
    return with_consistency(std::make_unique<Scripted>("fusion", kFuses, fused),
                            std::make_unique<Scripted>("lidar", kLidar, lidar),
                            std::make_unique<Scripted>("camera", kCamera, camera));
  }
  std::vector<Detection> answers() { return detector()->forward(view(), 0, false); }

  Calibration calibration;
  ImageF image{kWidth, kHeight, 3};
  std::vector<LidarPoint> points = {{1.f, 30.f, -1.7f, 0.f}};
  Script fused, lidar, camera;
};

const BevBox kSeen{15, 2, 4, 1.6, 0.1}, kBeside{15.2, 2.1, 4, 1.6, 0.15}, kElsewhere{30, -8, 4, 1.6, 0};

TEST(Consistent, WhatNoSensorSeesAloneIsNoCar) {
  Crossing world;
  world.fused.lines = {{{kSeen, 6}}, {{kElsewhere, 6}}, {{kSeen, -5}}};
  world.lidar.lines = {{{kBeside, 1.5}}};
  const auto found = world.answers();
  ASSERT_EQ(found.size(), 3u);  // the LiDAR's own box needs the camera's support
  EXPECT_DOUBLE_EQ(found[0].logit, soft(3.5, 6));
  EXPECT_DOUBLE_EQ(found[1].logit, soft(kNoDetectionLogit + kVoteMargin, 6));
  EXPECT_LT(found[1].score(), 0.01);
  EXPECT_DOUBLE_EQ(found[2].logit, -5);  // too low to change
}

TEST(Consistent, WhatBothSensorsSeeIsFoundThoughTheFusionDoesNot) {
  Crossing world;
  world.fused.lines = {{{kSeen, -7}}};
  world.lidar.lines = {{{kBeside, 2}}, {{kElsewhere, 3}}};
  PictureBox moved = world.seen(kBeside);
  moved.left += 0.4;
  world.camera.lines = {{{{}, 1, moved}}, {{{}, 0.5, world.seen(kBeside)}}};
  const auto found = world.answers();
  ASSERT_EQ(found.size(), 2u);
  EXPECT_DOUBLE_EQ(found[1].logit,
                   soft(1, 2));  // the camera is the less certain, of its two boxes the better
  EXPECT_DOUBLE_EQ(found[1].box.bev.x, kBeside.x);
  // Without a picture only the fusion and the LiDAR vote.
  const auto blind = world.detector()->forward({nullptr, world.points, &world.calibration}, 0, false);
  ASSERT_EQ(blind.size(), 1u);
  EXPECT_DOUBLE_EQ(blind[0].logit, -7);
}

TEST(Consistent, AThresholdIsOfTheAnswer) {
  Crossing world;
  world.fused.lines = {{{kElsewhere, 6}}, {{kSeen, 6}}};
  world.camera.lines = {{{{}, 0, world.seen(kSeen)}}};
  const auto found = world.detector()->forward(world.view(), 0.5, false);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_DOUBLE_EQ(found[0].logit, soft(2, 6));
  EXPECT_TRUE(world.detector()->forward(world.view(), 0.95, false).empty());
}

/// Σ weights · logits of the answers, which change with the pixel and the point.
double value_of(Crossing& world, const std::vector<double>& weights) {
  const auto found = world.answers();
  EXPECT_EQ(found.size(), weights.size());
  double sum = 0;
  for (std::size_t i = 0; i < found.size(); ++i) sum += weights[i] * found[i].logit;
  return sum;
}

TEST(Consistent, GradientIsThatOfTheLogitThatDecides) {
  RandomStream random(5, "consistency");
  int by_fusion = 0, by_camera = 0, by_lidar = 0;
  for (int trial = 0; trial < 200; ++trial) {
    Crossing world;
    const auto line = [&](const BevBox& box) {
      return Script::Line{{box, random.uniform(-3.5, 6)}, random.uniform(-1, 1), random.uniform(-1, 1)};
    };
    world.fused.lines = {line(kSeen), line(kElsewhere)};
    world.lidar.lines = {line(kBeside)};
    world.camera.lines = {line({})};
    world.camera.lines[0].proposal.picture = world.seen(kBeside);
    const auto detector = world.detector();
    const auto found = detector->forward(world.view(), 0, true);
    std::vector<double> weights(found.size());
    for (double& weight : weights) weight = random.uniform(-1, 1);
    const SensorGradient gradient = detector->backward(weights);
    constexpr float step = 1.f / 1024;
    for (const bool pixel : {true, false}) {
      float& input = pixel ? world.image.data[0] : world.points[0].x;
      const float before = input;
      input = before + step;
      const double above = value_of(world, weights);
      input = before - step;
      const double below = value_of(world, weights);
      input = before;
      EXPECT_NEAR(pixel ? gradient.image.data[0] : gradient.points[0][0], (above - below) / (2 * step), 2e-3)
          << "trial " << trial;
    }
    // Finds which member decided the first answer, from the logits of each.
    const auto said = [&](const Script& script, bool sees, bool measures) {
      const Script::Line& first = script.lines[0];
      return first.proposal.logit + (sees ? first.of_pixel * world.image.data[0] : 0) +
             (measures ? first.of_point * world.points[0].x : 0);
    };
    const double fused = said(world.fused, true, true), lidar = said(world.lidar, false, true),
                 camera = said(world.camera, true, false), cap = std::max(lidar, camera) + kVoteMargin;
    EXPECT_NEAR(found[0].logit, cap < fused ? soft(cap, fused) : fused, 1e-6);
    ++(fused <= cap ? by_fusion : lidar > camera ? by_lidar : by_camera);
  }
  EXPECT_GT(std::min({by_fusion, by_camera, by_lidar}), 5);
}

/// Returns a gradient for its second camera, too.
class WithCameraBeside : public Scripted {
 public:
  using Scripted::Scripted;
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient = Scripted::backward(d_logits);
    gradient.others["back"] = {static_cast<float>(d_logits[0]), 1};
    return gradient;
  }
};

TEST(Consistent, GradientsToOtherSensorsAreAdded) {
  Crossing world;
  world.fused.lines = {{{kSeen, 6}}};
  world.lidar.lines = {{{kBeside, 1.5}}};
  const auto detector = with_consistency(std::make_unique<WithCameraBeside>("fusion", kFuses, world.fused),
                                         std::make_unique<WithCameraBeside>("lidar", kLidar, world.lidar),
                                         std::make_unique<Scripted>("camera", kCamera, world.camera));
  ASSERT_EQ(detector->forward(world.view(), 0, true).size(), 1u);
  const std::vector<float> sum = detector->backward(std::vector<double>{2}).others.at("back");
  ASSERT_EQ(sum.size(), 2u);
  EXPECT_NEAR(sum[0], 2, 1e-6);  // the two shares of one logit
  EXPECT_EQ(sum[1], 2);
}

TEST(Consistent, SuppressionKeepsTheBestBoxOfThoseWithTheSameVote) {
  Crossing world;
  BevBox poor = kSeen;
  poor.x += 1.5;
  world.fused.lines = {{{poor, 5}}, {{kSeen, 7}}};
  world.lidar.lines = {{{kBeside, -1}}};
  const auto kept = suppress(world.answers());
  ASSERT_EQ(kept.size(), 1u);
  EXPECT_DOUBLE_EQ(kept[0].box.bev.x, kSeen.x);
}

TEST(Consistent, SaysWhatItsMembersCan) {
  Crossing world;
  const auto detector = world.detector();
  EXPECT_EQ(detector->name(), "fusion");
  EXPECT_TRUE(detector->capabilities().reads_image && detector->capabilities().reads_points);
  EXPECT_FALSE(detector->capabilities().knows_presence);
  EXPECT_EQ(detector->capabilities().why_whole, kFuses.why_whole);
  const auto all_local = [&](bool camera_is_local) {
    Capabilities fuses = kFuses, ranges = kLidar, sees = kCamera;
    for (Capabilities* can : {&fuses, &ranges}) can->why_whole.clear(), can->knows_presence = true;
    sees.why_whole = camera_is_local ? "" : "it is slow";
    return with_consistency(std::make_unique<Scripted>("fusion", fuses, world.fused),
                            std::make_unique<Scripted>("lidar", ranges, world.lidar),
                            std::make_unique<Scripted>("camera", sees, world.camera))
        ->capabilities();
  };
  EXPECT_TRUE(all_local(true).knows_presence);
  EXPECT_EQ(all_local(true).why_whole, "");
  EXPECT_EQ(all_local(false).why_whole, "it is slow");
  world.fused.lines = {{{kElsewhere, 6}}};
  EXPECT_DOUBLE_EQ(detector->share()->forward(world.view(), 0, false)[0].logit,
                   soft(kNoDetectionLogit + kVoteMargin, 6));
  EXPECT_EQ(detector->train_step({}, 0).total, 1);
  EXPECT_TRUE(detector->forward({&world.image, {}, &world.calibration}, 0, false).size() == 1);
  EXPECT_THAT(error_text<FieldError>([&] {
                with_consistency(std::make_unique<Scripted>("camera", kCamera, world.camera),
                                 std::make_unique<Scripted>("lidar", kLidar, world.lidar),
                                 std::make_unique<Scripted>("camera", kCamera, world.camera));
              }),
              ::testing::HasSubstr("camera finds no boxes from above"));
}

}  // namespace
}  // namespace mirage
