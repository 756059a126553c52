// Detection files, and the height of bird's-eye-view boxes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/random.h"
#include "detection/car_in_picture.h"
#include "detection/detect.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

/// A road 1.7 m below the LiDAR, and a car 1.4 m high at (12, 3).
Frame frame_with_car() {
  Frame frame;
  frame.id = "000004";
  frame.calibration.camera = {700, 700, 600, 180, 1200, 360};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  RandomStream random(5, "detection files");
  for (int i = 0; i < 4000; ++i)
    frame.sweep.push_back({static_cast<float>(random.uniform(0, 40)),
                           static_cast<float>(random.uniform(-10, 10)), -1.7f, 0.3f});
  for (int i = 0; i < 200; ++i)
    frame.sweep.push_back({static_cast<float>(12 + random.uniform(-1.8, 1.8)),
                           static_cast<float>(3 + random.uniform(-0.8, 0.8)),
                           static_cast<float>(random.uniform(-1.7, -0.3)), 0.3f});
  return frame;
}
const BevBox kCar{12, 3, 4, 1.8, 0};

TEST(Upright, BottomAndHeightComeFromTheSweep) {
  const Frame frame = frame_with_car();
  const Box3 box = upright(kCar, frame.sweep);
  EXPECT_NEAR(box.bottom, -1.7, 0.01);
  EXPECT_NEAR(box.height, 1.4, 0.08);
  EXPECT_EQ(box.bev.x, kCar.x);
  const Box3 bare = upright(BevBox{25, -4, 4, 1.8, 0.4}, frame.sweep);  // the road alone
  EXPECT_NEAR(bare.bottom, -1.7, 0.01);
  EXPECT_EQ(bare.height, kNominalHeight);
  EXPECT_NEAR(upright(BevBox{200, 0, 4, 1.8, 0}, frame.sweep).bottom, -1.7, 0.01);  // no return near
  EXPECT_EQ(upright(kCar, {}).height, kNominalHeight);
  Frame mirrored = frame;
  for (int i = 0; i < 30; ++i) mirrored.sweep.push_back({12.f, 3.f, -25.f, 0.1f});
  EXPECT_NEAR(upright(kCar, mirrored.sweep).bottom, -1.7, 0.01);
}

TEST(Upright, OnLabelledCarsOfRealFrames) {
  const auto data = test::real_frames();
  if (data.empty()) GTEST_SKIP() << "no real frames";
  double bottom = 0, height = 0;
  int count = 0;
  for (const std::string& id : list_frames(data)) {
    const Frame frame = read_frame(data, id);
    for (const Label& label : frame.labels) {
      if (label.type != "Car") continue;
      const Box3 box = upright(label.box.bev, frame.sweep);
      bottom += std::abs(box.bottom - label.box.bottom);
      height += std::abs(box.height - label.box.height);
      ++count;
    }
  }
  ASSERT_GT(count, 50);
  std::printf("%d cars: bottom off by %.3f m, height by %.3f m\n", count, bottom / count, height / count);
  EXPECT_LT(bottom / count, 0.1);
  EXPECT_LT(height / count, 0.1);
}

TEST(DetectionFiles, WhatDetectWritesInBothFormatsIsTheSame) {
  const TemporaryFolder folder;
  const Frame frame = frame_with_car();
  std::vector<Detection> found(2);
  found[0] = {kCar, 2.0, {100, 50, 200, 120}};
  found[1] = {{20, -4, 4.2, 1.7, 0.7}, 0.3, {}};
  write_results(folder / "kitti" / "000004.txt", kitti_detections(found, kFromAbove, frame),
                frame.calibration);
  nlohmann::json list;
  for (const Detection& p : found) {
    list.push_back({{"x", p.box.bev.x},
                    {"y", p.box.bev.y},
                    {"length", p.box.bev.length},
                    {"width", p.box.bev.width},
                    {"yaw", p.box.bev.yaw},
                    {"score", p.score()}});
    if (area(p.picture) > 0)
      list.back()["picture"] = {{"left", p.picture.left},
                                {"top", p.picture.top},
                                {"right", p.picture.right},
                                {"bottom", p.picture.bottom}};
  }
  nlohmann::json one = {{"frame", "000004"}, {"detections", list}};
  write_json(folder / "detections.json", {{"frames", nlohmann::json::array({one})}});
  for (const char* place : {"kitti", "kitti/000004.txt", "detections.json", ""}) {
    const DetectionFiles files(folder / place);
    EXPECT_TRUE(files.has("000004")) << place;
    EXPECT_FALSE(files.has("000005")) << place;
    const auto back = files.of(frame);
    ASSERT_EQ(back.size(), 2u) << place;
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_NEAR(back[i].box->bev.x, found[i].box.bev.x, 2e-6);
      EXPECT_NEAR(back[i].box->bev.yaw, found[i].box.bev.yaw, 2e-6);
      EXPECT_NEAR(back[i].box->bottom, upright(found[i], frame.sweep).bottom, 2e-6);
      EXPECT_NEAR(back[i].score, found[i].score(), 1e-9);
    }
    EXPECT_NEAR(back[0].picture->right, 200, 1e-9);
  }
}

TEST(DetectionFiles, OfAnotherKindAreNamed) {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder / "empty");
  write_json(folder / "a.json", {{"boxes", 1}});
  write_json(folder / "b.json", {{"frames", {{{"frame", "000004"}, {"detections", {{{"x", 1}}}}}}}});
  for (const auto& [place, word] :
       {std::pair("none", "No such file"), {"empty", "holds no detections"}, {"a.json", "frames"}})
    EXPECT_THAT(error_text<InputError>([&] { DetectionFiles(folder / place); }),
                AllOf(HasSubstr(place), HasSubstr(word)));
  EXPECT_THAT(error_text<InputError>([&] { DetectionFiles(folder / "b.json").of(frame_with_car()); }),
              AllOf(HasSubstr("b.json"), HasSubstr("frame 000004, detection 0.score")));
  write_json(folder / "c.json",
             {{"frames",
               {{{"frame", "000004"},
                 {"detections",
                  {{{"x", 1}, {"y", 2}, {"length", 1e300}, {"width", 2}, {"yaw", 0}, {"score", 1}}}}}}}});
  EXPECT_THAT(error_text<InputError>([&] { DetectionFiles(folder / "c.json"); }),
              HasSubstr("frame 000004, detection 0: the box"));
}

TEST(DetectionFiles, WhatDetectNeverWritesIsRefused) {
  const TemporaryFolder folder;
  const nlohmann::json right = {{"x", 9},   {"y", 2},       {"length", 4},    {"width", 2},
                                {"yaw", 0}, {"score", 0.5}, {"bottom", -1.7}, {"height", 1.5}};
  const auto text = [&](const nlohmann::json& frames) {
    write_json(folder / "d.json", {{"frames", frames}});
    return error_text<InputError>([&] { DetectionFiles(folder / "d.json"); });
  };
  const auto with = [&](const char* field, double value) {
    nlohmann::json detection = right;
    detection[field] = value;
    return text({{{"frame", "000004"}, {"detections", {detection}}}});
  };
  EXPECT_THAT(with("score", 5), HasSubstr("detection 0.score: 5 is not a score from 0 to 1"));
  EXPECT_THAT(with("score", -3), HasSubstr("detection 0.score"));
  EXPECT_THAT(with("height", -2), HasSubstr("detection 0.height: -2 m is not a height"));
  const nlohmann::json frame = {{"frame", "000004"}, {"detections", {right}}};
  EXPECT_THAT(text({frame, frame}), HasSubstr("frames.1: lists the frame 000004 again"));
}

TEST(DetectionFiles, NamesOfAnyBytesAreFoundAgain) {
  const TemporaryFolder folder;
  for (const std::string id : {"a\\b", "a\xff\x01z", "\\x41", "plain"}) {
    write_json(folder / "detections.json",
               {{"frames", {{{"frame", escape_name(id)}, {"detections", nlohmann::json::array()}}}}});
    EXPECT_TRUE(DetectionFiles(folder / "detections.json").has(id)) << escape_name(id);
  }
}

}  // namespace

// AP by KITTI's development kit: each of its rules, worked out by hand.

namespace {

Label label(double x, const char* type = "Car", double height = 50, int occluded = 0, double truncated = 0) {
  Label result;
  result.type = type;
  result.occluded = occluded, result.truncated = truncated;
  result.left = 10 * x, result.right = 10 * x + 80, result.top = 100, result.bottom = 100 + height;
  result.box = {{x, 0, 4, 1.8, 0}, -1.7, 1.5};
  return result;
}

/// A detection on a label, shifted by `off` m and pixels.
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

/// 40 cars, all found except the last `missed`, with falling scores.
std::vector<KittiFrame> forty(int missed = 0) {
  std::vector<KittiFrame> frames;
  for (int i = 0; i < 40; ++i) {
    KittiFrame frame{{label(20)}, {}};
    if (i < 40 - missed) frame.detections.push_back(on(frame.labels[0], 0.9 - 0.01 * i));
    frames.push_back(std::move(frame));
  }
  return frames;
}

TEST(KittiAp, IsOfTheFirstCamera) {
  std::vector<KittiFrame> frames = forty();
  const double alone = ap(frames);
  frames[0].labels.push_back(label(9));
  frames[0].labels.back().camera = 1;
  EXPECT_EQ(kitti_average_precision(frames, kInPicture, Difficulty::moderate, 0.7).cars, 40);
  EXPECT_EQ(ap(frames), alone);
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
  // A label that is only in the picture is no car from above.
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
