// AP by KITTI's development kit: each of its rules by hand.
#include <gtest/gtest.h>

#include "detection/kitti_ap.h"

namespace mirage {
namespace {

Label label(double x, const char* type = "Car", double height = 50, int occluded = 0, double truncated = 0) {
  Label result;
  result.type = type;
  result.occluded = occluded, result.truncated = truncated;
  result.left = 10 * x, result.right = 10 * x + 80, result.top = 100, result.bottom = 100 + height;
  result.box = {{x, 0, 4, 1.8, 0}, -1.7, 1.5};
  return result;
}

/// On a label, `off` m and pixels beside it.
KittiDetection on(const Label& of, double score, double off = 0) {
  KittiDetection result;
  result.score = score;
  result.box = of.box;
  result.box->bev.x += off;
  result.picture = {of.left + off, of.top, of.right + off, of.bottom};
  return result;
}

double ap(const std::vector<KittiFrame>& frames, Matching matching = kInPicture,
          Difficulty level = Difficulty::moderate, double iou = 0.7) {
  return kitti_average_precision(frames, matching, level, iou).average_precision;
}

/// 40 cars that are all found but the last `missed`, scores falling.
std::vector<KittiFrame> forty(int missed = 0) {
  std::vector<KittiFrame> frames;
  for (int i = 0; i < 40; ++i) {
    KittiFrame frame{{label(20)}, {}};
    if (i < 40 - missed) frame.detections.push_back(on(frame.labels[0], 0.9 - 0.01 * i));
    frames.push_back(std::move(frame));
  }
  return frames;
}

TEST(KittiAp, HasNoEndOfTheCurveWhereCarsAreFewerThanItsThresholds) {
  // 40 cars have 40 thresholds, the first of which AP leaves out.
  EXPECT_NEAR(ap(forty()), 39.0 / 40, 1e-12);
  EXPECT_NEAR(ap(forty(10)), 29.0 / 40, 1e-12);
  std::vector<KittiFrame> cars = forty();
  cars.resize(25);
  EXPECT_NEAR(ap(cars), 24.0 / 40, 1e-12);
  EXPECT_EQ(kitti_average_precision(cars, kFromAbove, Difficulty::easy, 0.7).cars, 25);
  std::vector<KittiFrame> twice = forty(), more = forty();
  twice.insert(twice.end(), more.begin(), more.end());
  EXPECT_NEAR(ap(twice), 1, 1e-12);
}

TEST(KittiAp, WhatNobodyLabelledCountsNeitherWay) {
  std::vector<KittiFrame> frames = forty();
  frames.push_back({{}, {on(label(60), 0.95)}, false});
  EXPECT_NEAR(ap(frames), 39.0 / 40, 1e-12);
  frames.back().labelled = true;
  EXPECT_LT(ap(frames), 38.5 / 40);
  // A label of the picture alone is no car from above.
  frames = forty();
  for (KittiFrame& frame : frames) frame.labels[0].in_space = false;
  EXPECT_NEAR(ap(frames), 39.0 / 40, 1e-12);
  EXPECT_EQ(kitti_average_precision(frames, kFromAbove, Difficulty::easy, 0.7).cars, 0);
}

TEST(KittiAp, FalseAlarmsCountFromTheirScoreOn) {
  std::vector<KittiFrame> frames = forty();
  frames[0].detections.push_back(on(label(60), 0.705));  // below the first 20 cars
  double wanted = 0;
  for (int t = 1; t < 40; ++t) {
    // the best precision at that recall or above
    double best = 0;
    for (int s = t; s < 40; ++s) best = std::max(best, s + 1 <= 20 ? 1.0 : (s + 1.0) / (s + 2));
    wanted += best / 40;
  }
  EXPECT_NEAR(ap(frames), wanted, 1e-12);
}

TEST(KittiAp, VansAndHarderCarsAreNeutralOnlyAboveTheLimit) {
  for (const Label& neutral : {label(60, "Van"), label(60, "Car", 50, 2), label(60, "Car", 50, 0, 0.4)}) {
    std::vector<KittiFrame> frames = forty();
    for (KittiFrame& frame : frames) frame.labels.push_back(neutral);
    const double none = ap(frames);
    EXPECT_NEAR(none, 39.0 / 40, 1e-12);
    frames[0].detections.push_back(on(neutral, 0.99));
    EXPECT_NEAR(ap(frames), none, 1e-12);
    frames[1].detections.push_back(on(neutral, 0.99, 25));  // IoU 0.52: half of it lies inside
    EXPECT_LT(ap(frames), none);
  }
}

TEST(KittiAp, TrucksTramsAndMiscAreBackground) {
  for (const char* type : {"Truck", "Tram", "Misc", "Pedestrian"}) {
    std::vector<KittiFrame> frames = forty();
    frames[0].labels.push_back(label(60, type));
    frames[0].detections.push_back(on(frames[0].labels.back(), 0.99));
    EXPECT_LT(ap(frames), 39.0 / 40) << type;
  }
}

TEST(KittiAp, DontCareForgivesInThePictureByTheShareOfTheDetection) {
  std::vector<KittiFrame> frames = forty();
  Label region = label(60, "DontCare", 200);
  region.left -= 300, region.right += 300;
  frames[0].labels.push_back(region);
  KittiDetection inside = on(label(60), 0.99);
  frames[0].detections.push_back(inside);
  EXPECT_NEAR(ap(frames), 39.0 / 40, 1e-12);  // its IoU with the region is small
  EXPECT_LT(ap(frames, kFromAbove), 39.0 / 40);
  frames[0].detections.back().picture->bottom += 160;  // 200 of 210 rows
  EXPECT_NEAR(ap(frames), 39.0 / 40, 1e-12);
  frames[0].detections.back().picture->top -= 100;  // 200 of 310
  EXPECT_LT(ap(frames), 39.0 / 40);
}

TEST(KittiAp, LowDetectionsAreNeitherHitsNorAlarms) {
  std::vector<KittiFrame> frames = forty();
  frames[0].detections.push_back(on(label(60, "Car", 24), 0.99));
  EXPECT_NEAR(ap(frames), 39.0 / 40, 1e-12);
  frames[0].detections.back() = on(label(60, "Car", 26), 0.99);
  EXPECT_LT(ap(frames), 39.0 / 40);
  EXPECT_NEAR(ap(frames, kInPicture, Difficulty::easy), 39.0 / 40, 1e-12);  // under 40 pixels
  // A car 27 pixels high with a box of 24: IoU 0.89, and no hit.
  std::vector<KittiFrame> cut = forty();
  for (KittiFrame& frame : cut) {
    frame.labels[0].bottom = frame.labels[0].top + 27;
    frame.detections[0].picture->bottom = frame.labels[0].top + 24;
  }
  EXPECT_EQ(ap(cut), 0);
  EXPECT_EQ(ap(cut, kFromAbove), 0);
}

TEST(KittiAp, ALimitIsPassedNotReached) {
  std::vector<KittiFrame> frames = forty();
  for (KittiFrame& frame : frames) frame.detections[0].box->bev.length = 2;  // IoU 0.5
  EXPECT_EQ(ap(frames, kFromAbove, Difficulty::moderate, 0.5), 0);
  EXPECT_GT(ap(frames, kFromAbove, Difficulty::moderate, 0.49), 0.9);
}

TEST(KittiAp, ALevelWithoutCarsHasNoFigure) {
  std::vector<KittiFrame> frames = forty();
  for (KittiFrame& frame : frames) frame.labels[0].occluded = 1;
  const Matching ways[] = {kFromAbove};
  const auto json = kitti_ap_json(frames, ways);
  EXPECT_TRUE(json.at("bev").at("easy").is_null());
  EXPECT_NEAR(json.at("bev").at("moderate").get<double>(), 39.0 / 40, 1e-12);
  EXPECT_EQ(json.at("iou"), 0.7);
  EXPECT_EQ(json.at("cars").at("hard"), 40);
  EXPECT_TRUE(json.at("iou50").at("bev").contains("hard"));
  EXPECT_FALSE(json.contains("image"));
}

}  // namespace
}  // namespace mirage
