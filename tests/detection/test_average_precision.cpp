// AP, suppression and the rule for labels that count, against cases worked out by hand.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <random>

#include "base/error.h"
#include "base/sizes.h"
#include "detection/average_precision.h"

namespace mirage {
namespace {

BevBox car(double x, double y = 0) {
  return {x, y, 4, 2, 0};
}
Detection found(const BevBox& box, double logit) {
  return {box, logit};
}
TruthBox at_level(const ObjectBoxes& boxes, Difficulty difficulty, double distance = 0) {
  TruthBox truth = boxes;
  truth.difficulty = difficulty;
  truth.distance = distance;
  return truth;
}
std::vector<std::size_t> labels_of(const TruthBoxes& truth) {
  std::vector<std::size_t> labels;
  for (const TruthBox& box : truth.boxes) labels.push_back(box.label);
  return labels;
}

TEST(Suppress, KeepsTheBestOfOverlappingBoxesAndAllOthers) {
  const auto kept =
      suppress({found(car(10), 1), found(car(10.5), 3), found(car(20), 2), found(car(13.9), 0)}, 0.1);
  ASSERT_EQ(kept.size(), 3u);
  EXPECT_EQ(kept[0].logit, 3);
  EXPECT_EQ(kept[1].logit, 2);
  EXPECT_EQ(kept[2].box.bev.x, 13.9);  // overlaps 10.5 by 0.6 m of 4: IoU 0.081
}

TEST(Suppress, BreaksTiesByInputOrder) {
  const auto kept = suppress({found(car(10), 1), found(car(10.5), 1)}, 0.1);
  ASSERT_EQ(kept.size(), 1u);
  EXPECT_EQ(kept[0].box.bev.x, 10);
}

TEST(AveragePrecision, PerfectDetectionsScoreOne) {
  const std::vector<ScoredFrame> frames = {
      {{found(car(10), 2), found(car(20), 1)}, {{car(10), car(20)}, {}, {}}}};
  const auto result = average_precision(frames, 0.7);
  EXPECT_DOUBLE_EQ(result.average_precision, 1);
  EXPECT_DOUBLE_EQ(result.recall, 1);
  EXPECT_EQ(result.boxes, 2);
}

TEST(AveragePrecision, AFalseAlarmAboveAHitLowersThePrecisionFromThere) {
  // By score: hit (P 1, R 1/2), false alarm (P 1/2), hit (P 2/3, R 1). 20 recalls at 1 and 20 at 2/3.
  const std::vector<ScoredFrame> frames = {
      {{found(car(10), 3), found(car(40), 2), found(car(20), 1)}, {{car(10), car(20)}, {}, {}}}};
  EXPECT_NEAR(average_precision(frames, 0.5).average_precision, 0.5 + 0.5 * 2 / 3, 1e-12);
}

TEST(AveragePrecision, MissedBoxesLimitTheRecall) {
  const std::vector<ScoredFrame> frames = {
      {{found(car(10), 3)}, {{car(10), car(20), car(30), car(40)}, {}, {}}}};
  const auto result = average_precision(frames, 0.5);
  EXPECT_NEAR(result.average_precision, 0.25, 1e-12);
  EXPECT_NEAR(result.recall, 0.25, 1e-12);
}

TEST(AveragePrecision, ItsIntervalIsThatOfTheFrames) {
  // One car per frame, found in 70 of 100: AP is the share of drawn frames with a hit, which is binomial.
  std::vector<ScoredFrame> frames(100, {{}, {{car(10)}, {}, {}}});
  for (std::size_t i = 0; i < 70; ++i) frames[i].detections = {found(car(10), 1)};
  const Interval interval = average_precision_interval(frames, 0.5);
  EXPECT_DOUBLE_EQ(interval.value, average_precision(frames, 0.5).average_precision);
  EXPECT_NEAR(interval.low, 0.61, 0.03);
  EXPECT_NEAR(interval.high, 0.79, 0.03);
  EXPECT_EQ(average_precision_interval({}, 0.5).high, 1);
}

/// 100 frames with a car each, found in the first 70.
std::vector<ScoredFrame> seventy_found() {
  std::vector<ScoredFrame> frames(100, {{}, {{car(10)}, {}, {}}});
  for (std::size_t i = 0; i < 70; ++i) frames[i].detections = {found(car(10), 1)};
  return frames;
}

TEST(AveragePrecision, BoxesOfOneVehicleAreDrawnTogether) {
  // The same hundred boxes of ten vehicles, seven of which are always found: as uncertain as ten trials.
  std::vector<ScoredFrame> frames = seventy_found();
  const Interval apart = average_precision_interval(frames, 0.5);
  EXPECT_EQ(clusters_of(frames).count, 100);
  EXPECT_EQ(clusters_of(frames).by, "frame");
  for (std::size_t i = 0; i < frames.size(); ++i) frames[i].truth.boxes[0].track = static_cast<int>(i / 10);
  const Interval together = average_precision_interval(frames, 0.5);
  EXPECT_DOUBLE_EQ(together.value, apart.value);
  EXPECT_NEAR(together.low, 0.37, 0.05);  // Wilson with t of 9 degrees
  EXPECT_GT(together.high - together.low, 2.5 * (apart.high - apart.low));
  EXPECT_EQ(clusters_of(frames).count, 10);
  EXPECT_EQ(clusters_of(frames).by, "vehicle");
  // A box without an identity stays with its frame.
  for (std::size_t i = 0; i < frames.size(); ++i) frames[i].truth.boxes[0].track = -1;
  EXPECT_DOUBLE_EQ(average_precision_interval(frames, 0.5).low, apart.low);
}

/// Frames with 1 to 6 cars, each found with its frame's own probability (beta, mean `recall`, correlation
/// `within`). Scores lie above most of the false alarms, of which there is one per frame on average.
std::vector<ScoredFrame> drawn_frames(std::mt19937_64& random, int count, double recall, double within) {
  std::vector<ScoredFrame> frames;
  for (int f = 0; f < count; ++f) {
    double own = recall;
    if (within > 0) {
      const double a = std::gamma_distribution<>(recall * (1 - within) / within)(random),
                   b = std::gamma_distribution<>((1 - recall) * (1 - within) / within)(random);
      own = a + b > 0 ? a / (a + b) : recall;
    }
    ScoredFrame frame;
    const int cars = std::uniform_int_distribution<>(1, 6)(random),
              alarms = std::poisson_distribution<>(1)(random);
    for (int i = 0; i < cars; ++i) {
      frame.truth.boxes.push_back(car(10.0 * (i + 1)));
      if (std::bernoulli_distribution(own)(random))
        frame.detections.push_back(found(car(10.0 * (i + 1)), std::normal_distribution<>(1.5, 1)(random)));
    }
    for (int i = 0; i < alarms; ++i)
      frame.detections.push_back(found(car(10.0 * (i + 1), 30), std::normal_distribution<>(0, 1)(random)));
    frames.push_back(std::move(frame));
  }
  return frames;
}

TEST(AveragePrecision, ItsIntervalCoversAsOftenAsSaid) {
  constexpr std::array<double, 3> kRecalls = {0.5, 0.75, 0.9};
  for (const double within : {0.0, 0.3}) {
    std::mt19937_64 random(within > 0 ? 7 : 8);
    std::array<double, 3> truth{};  // over very many frames
    for (std::size_t r = 0; r < kRecalls.size(); ++r)
      truth[r] = average_precision(drawn_frames(random, 5000, kRecalls[r], within), 0.7).average_precision;
    for (const int clusters : {5, 7, 20, 100}) {
      const int trials = clusters > 50 ? 240 : 900;
      int covered = 0;
      for (int t = 0; t < trials; ++t) {
        const std::size_t r = as_size(t) % kRecalls.size();
        const Interval interval =
            average_precision_interval(drawn_frames(random, clusters, kRecalls[r], within), 0.7);
        covered += interval.low <= truth[r] && truth[r] <= interval.high;
      }
      const double coverage = static_cast<double>(covered) / trials;
      RecordProperty(fmt::format("clusters_{}_within_{}", clusters, within), std::to_string(coverage));
      EXPECT_GE(coverage, 0.9) << clusters << " " << within;
    }
  }
}

TEST(AveragePrecision, FalseAlarmsAreDrawnWithTheirFrame) {
  // Ten vehicles, always found, below a higher-scored false alarm in half of the frames: only the number of
  // drawn frames with an alarm varies.
  std::vector<ScoredFrame> frames(40, {{found(car(10), 1)}, {{car(10)}, {}, {}}});
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i].truth.boxes[0].track = static_cast<int>(i % 10);
    if (i % 2 == 0) frames[i].detections.push_back(found(car(40), 2));
  }
  const Interval interval = average_precision_interval(frames, 0.5);
  EXPECT_NEAR(interval.value, 40 / 60.0, 1e-12);
  EXPECT_LT(interval.low, interval.value);
  EXPECT_GT(interval.high, interval.value);
  // A single vehicle leaves nothing to draw from.
  for (ScoredFrame& frame : frames) frame.truth.boxes[0].track = 7;
  EXPECT_EQ(average_precision_interval(frames, 0.5).low, 0);
  EXPECT_EQ(average_precision_interval(frames, 0.5).high, 1);
}

TEST(AveragePrecision, ADifferenceIsPaired) {
  // The second detector misses ten more cars than the first, of the same hundred.
  const std::vector<ScoredFrame> first = seventy_found();
  std::vector<ScoredFrame> second = first;
  for (std::size_t i = 0; i < 10; ++i) second[i].detections.clear();
  const Interval difference = average_precision_difference(first, second, 0.5);
  EXPECT_NEAR(difference.value, 0.1, 1e-12);
  EXPECT_GT(difference.low, 0);
  EXPECT_LT(difference.high, 0.2);
  const Interval none = average_precision_difference(first, first, 0.5);
  EXPECT_EQ(none.value, 0);
  EXPECT_NEAR(none.high, 0.02, 0.002);  // the allowance for a hundred clusters
  EXPECT_EQ(none.low, -none.high);
  EXPECT_EQ(average_precision_difference({}, {}, 0.5).low, -1);
}

TEST(AveragePrecision, ASecondDetectionOfOneBoxIsAFalseAlarm) {
  const std::vector<ScoredFrame> frames = {
      {{found(car(10), 3), found(car(10.1), 2), found(car(20), 1)}, {{car(10), car(20)}, {}, {}}}};
  EXPECT_NEAR(average_precision(frames, 0.5).average_precision, 0.5 + 0.5 * 2 / 3, 1e-12);
}

TEST(AveragePrecision, DetectionsOfIgnoredBoxesCountNeitherWay) {
  const std::vector<ScoredFrame> frames = {
      {{found(car(40), 3), found(car(10), 2)}, {{car(10)}, {car(40)}, {}}}};
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7).average_precision, 1);
}

TEST(AveragePrecision, TheOverlapDecides) {
  // Shifted by 1 m of 4: IoU = 3 / 5.
  const std::vector<ScoredFrame> frames = {{{found(car(11), 1)}, {{car(10)}, {}, {}}}};
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.5).average_precision, 1);
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7).average_precision, 0);
}

TEST(AveragePrecision, ScoresAreComparedAcrossFrames) {
  // The other frame's alarm scores highest: P 0, then 1/2 at R 1.
  const std::vector<ScoredFrame> frames = {{{found(car(10), 1)}, {{car(10)}, {}, {}}},
                                           {{found(car(30), 2)}, {}}};
  EXPECT_NEAR(average_precision(frames, 0.5).average_precision, 0.5, 1e-12);
}

TEST(AveragePrecision, NothingToFindScoresZero) {
  EXPECT_EQ(average_precision({}, 0.5).average_precision, 0);
}

PictureBox in_picture(double left, double height = 50, double width = 100) {
  return {left, 100, left + width, 100 + height};
}
Detection seen_at(const PictureBox& box, double logit) {
  return {{}, logit, box};
}

TEST(Suppress, InThePictureCarsBehindEachOtherStay) {
  // Shifted by 40 of 100 pixels: IoU 3 / 7; by 20: 2 / 3.
  const std::vector<Detection> found = {seen_at(in_picture(0), 3), seen_at(in_picture(40), 2),
                                        seen_at(in_picture(60), 1)};
  const auto kept = suppress(found, kInPicture);
  ASSERT_EQ(kept.size(), 2u);
  EXPECT_EQ(kept[1].picture.left, 40);
  EXPECT_THROW(suppress(found, kFromAbove), InputError);  // no boxes from above
}

/// Cars in the picture: easy at 10 m (0 …), moderate at 30 m (200 …), hard at 60 m (400 …), DontCare (600 …).
ScoredFrame picture_frame(std::vector<Detection> detections) {
  GroundTruth truth;
  truth.space.boxes = {car(10)};  // unused
  truth.picture.boxes = {at_level(in_picture(0, 110), Difficulty::easy, 10),
                         at_level(in_picture(200, 37), Difficulty::moderate, 30),
                         at_level(in_picture(400, 26), Difficulty::hard, 60)};
  truth.picture.ignore = {PictureBox{600, 80, 800, 200}};
  return scored(std::move(detections), truth, 720, kInPicture);
}

TEST(AveragePrecisionInThePicture, ByHand) {
  const Detection first = seen_at(in_picture(0, 110), 5), alarm = seen_at(in_picture(900), 4),
                  second = seen_at(in_picture(205, 37), 3);
  // By score: hit (P 1, R 1/3), alarm, hit (P 2/3, R 2/3): 13 recalls at 1, 13 at 2/3 (13/40 < 1/3).
  const std::vector<ScoredFrame> frames = {picture_frame({first, alarm, second})};
  const auto result = average_precision(frames, 0.7);
  EXPECT_EQ(result.boxes, 3);
  EXPECT_NEAR(result.average_precision, (13 + 13 * 2.0 / 3) / 40, 1e-12);
  EXPECT_NEAR(result.recall, 2.0 / 3, 1e-12);
  // Shifted by 5 of 100 pixels: IoU 95 / 105.
  EXPECT_NEAR(average_precision(frames, 0.95).recall, 1.0 / 3, 1e-12);
}

TEST(AveragePrecisionInThePicture, RegionsNobodyLabelledAndSmallBoxesCountNeitherWay) {
  const Detection hit = seen_at(in_picture(0, 110), 1);
  const double alone = average_precision(std::vector{picture_frame({hit})}, 0.5).average_precision;
  const auto with = [&](const PictureBox& other) {
    return average_precision(std::vector{picture_frame({hit, seen_at(other, 2)})}, 0.5).average_precision;
  };
  EXPECT_EQ(with({650, 100, 700, 140}), alone);  // inside DontCare
  EXPECT_EQ(with({780, 100, 810, 140}), alone);  // two thirds of it inside
  EXPECT_LT(with({795, 100, 825, 140}), alone);  // a sixth
  EXPECT_EQ(with(in_picture(900, 24)), alone);   // less than 25 pixels high
  EXPECT_LT(with(in_picture(900, 25)), alone);
}

TEST(AveragePrecisionInThePicture, StrataByDifficultyAndDistance) {
  const std::vector<ScoredFrame> frames = {picture_frame(
      {seen_at(in_picture(0, 110), 3), seen_at(in_picture(200, 37), 2), seen_at(in_picture(400, 26), 1)})};
  for (const Stratum& stratum : standard_strata()) {
    const PrecisionRecall part = average_precision(frames, 0.7, stratum);
    EXPECT_NEAR(part.average_precision, 1, 1e-12) << stratum.name;
    const int boxes = stratum.name == "hard"                                   ? 3
                      : stratum.name == "moderate" || stratum.name == "0-40 m" ? 2
                                                                               : 1;
    EXPECT_EQ(part.boxes, boxes) << stratum.name;
  }
  // A false alarm 100 pixels high is at 720 · 1.53 / 100 = 11 m; one of 30 does not count as "easy".
  const std::vector<ScoredFrame> near = {picture_frame({seen_at(in_picture(900, 100), 4)})},
                                 low = {picture_frame({seen_at(in_picture(900, 30), 4)})};
  const auto curve = [](const std::vector<ScoredFrame>& of, const Stratum& stratum) {
    return average_precision(of, 0.7, stratum).curve.size();
  };
  EXPECT_EQ(curve(near, {"0-20 m", 0, 20}), 1u);
  EXPECT_EQ(curve(near, {"20-40 m", 20, 40}), 0u);
  EXPECT_EQ(curve(low, {"20-40 m", 20, 40}), 1u);
  EXPECT_EQ(curve(low, {"easy", 0, 1e9, Difficulty::easy}), 0u);
  EXPECT_EQ(curve(low, {"moderate", 0, 1e9, Difficulty::moderate}), 1u);
}

TEST(GroundTruth, AppliesItsRules) {
  Label good;
  good.type = "Car";
  good.top = 100;
  good.bottom = 150;
  good.box = {car(10), -1.7, 1.5};
  Frame frame;
  frame.labels.assign(8, good);
  frame.labels[1].type = "Van";
  frame.labels[2].type = "Pedestrian";
  frame.labels[3].truncated = 0.6;
  frame.labels[4].occluded = 3;
  frame.labels[5].bottom = 120;
  frame.labels[6].box.bev = car(60);
  frame.labels[7].box.bev = car(30);
  frame.sweep.assign(3, LidarPoint{10, 0.5, -1, 0});  // the last car has no return: its pixels count
  frame.labels.push_back(good);
  frame.labels[8].type = "Misc";  // background, like the pedestrian
  const GroundTruth truth = ground_truth(frame, {0, 50, -25, 25});
  EXPECT_EQ(labels_of(truth.space), (std::vector<std::size_t>{0, 7}));
  EXPECT_EQ(truth.space.boxes.size(), 2u);
  EXPECT_EQ(truth.space.ignore.size(), 5u);
}

Label seen(double height, int occluded, double truncated) {
  Label label;
  label.type = "Car";
  label.top = 100;
  label.bottom = 100 + height;
  label.occluded = occluded;
  label.truncated = truncated;
  return label;
}

Frame frame_of(const std::vector<Label>& labels) {
  Frame frame;
  frame.labels = labels;
  return frame;
}

TEST(PictureTruth, CarsCountWhateverTheirDistanceAndReturns) {
  std::vector<Label> labels(9, seen(25, 2, 0.5));
  for (std::size_t i = 0; i < labels.size(); ++i) labels[i].left = static_cast<double>(i);
  labels[0].box.bev = car(120, 50);
  labels[1] = seen(24, 0, 0);
  labels[2] = seen(50, 3, 0);
  labels[3].type = "Van";
  labels[4].type = "Truck";
  labels[5].type = "Tram";
  labels[6].type = "DontCare";
  labels[7].type = "Pedestrian";
  labels[8].truncated = 0.6;
  const TruthBoxes truth = picture_truth(labels);
  EXPECT_EQ(labels_of(truth), std::vector<std::size_t>{0});
  ASSERT_EQ(truth.boxes.size(), 1u);
  EXPECT_EQ(truth.boxes[0].picture.bottom, 125);
  EXPECT_EQ(truth.boxes[0].difficulty, Difficulty::hard);
  EXPECT_DOUBLE_EQ(truth.boxes[0].distance, 130);
  EXPECT_EQ(truth.ignore.size(), 7u);  // all but the pedestrian
  EXPECT_TRUE(truth.look_alikes.empty());
  labels[7].type = "Misc";
  EXPECT_EQ(picture_truth(labels).look_alikes.size(), 1u);
  EXPECT_EQ(
      scored({}, ground_truth(frame_of(labels), {0, 50, -25, 25}), 0, kInPicture).truth.look_alikes.size(),
      1u);
  EXPECT_EQ(ground_truth(frame_of(labels), {0, 50, -25, 25}).picture.boxes.size(), 1u);
}

TEST(GroundTruth, OfAnUnlabelledFrameIgnoresAllThatIsFound) {
  Frame frame;
  frame.labelled = false;
  const GroundTruth nothing = ground_truth(frame, {0, 50, -25, 25});
  const TruthBoxes one{{car(10)}, {}, {}};
  for (const Matching matching : {kFromAbove, kInPicture}) {
    std::vector<ScoredFrame> frames;
    if (!matching.in_picture()) {
      frames = {{{found(car(10), 1)}, one}, scored({found(car(45, 20), 3)}, nothing, 700, matching)};
    } else {
      frames = {picture_frame({seen_at(in_picture(0, 110), 1)}),
                scored({seen_at(in_picture(900), 3)}, nothing, 700, matching)};
    }
    const double alone = average_precision(std::span(frames).first(1), 0.7).average_precision;
    EXPECT_GT(alone, 0);
    EXPECT_DOUBLE_EQ(average_precision(frames, 0.7).average_precision, alone);
  }
}

TEST(PictureTruth, LabelsOfThePictureAloneCountThereAlone) {
  std::vector<Label> labels = {seen(50, 0, 0)};
  labels[0].in_space = false;
  labels[0].right = 40;
  const GroundTruth truth = ground_truth(frame_of(labels), {-50, 50, -25, 25});
  EXPECT_TRUE(truth.space.boxes.empty());
  ASSERT_EQ(truth.picture.boxes.size(), 1u);
  const std::vector<ScoredFrame> frames = {scored({}, truth, 700, kInPicture)};
  EXPECT_EQ(average_precision(frames, 0.7, {"", 0, 20}).boxes, 0);  // their distance is unknown
  EXPECT_EQ(average_precision(frames, 0.7, {"", 0, 1e9}).boxes, 1);
}

TEST(PictureTruth, IsOfTheCamerasThatTheDetectorLooksAt) {
  std::vector<Label> labels(4, seen(50, 0, 0));
  for (std::size_t i = 0; i < labels.size(); ++i) labels[i].right = 40;
  labels[1].camera = 1, labels[2].camera = 2, labels[3].camera = 2, labels[3].type = "DontCare";
  Frame frame = frame_of(labels);
  for (const char* name : {"LEFT", "BACK"})
    frame.others.push_back({name, {}, Lazy<ImageF>([] { return ImageF(8, 4, 3); })});
  frame.measurements.push_back({"radar"});
  Capabilities can;
  const TruthBoxes first = ground_truth(frame, {-50, 50, -25, 25}, can).picture;
  ASSERT_EQ(first.boxes.size(), 1u);
  EXPECT_TRUE(first.ignore.empty());
  can.reads = {"BACK", "radar"};
  const TruthBoxes both = ground_truth(frame, {-50, 50, -25, 25}, can).picture;
  EXPECT_EQ(labels_of(both), (std::vector<std::size_t>{0, 2}));
  ASSERT_EQ(both.boxes.size(), 2u);
  EXPECT_EQ(both.boxes[0].camera, 0);
  EXPECT_EQ(both.boxes[1].picture.right, 40);
  ASSERT_EQ(both.ignore.size(), 1u);
  // By the detector's number of the box's camera.
  const auto all = sensors(view_of(frame), can, "detector");
  EXPECT_EQ(all.at(static_cast<std::size_t>(both.boxes[1].camera)).name, "BACK");
  EXPECT_EQ(both.ignore[0].camera, both.boxes[1].camera);
  EXPECT_EQ(kInPicture.overlap(both.boxes[0], both.boxes[1]), 0);
}

TEST(Difficulty, FollowsKittisLimits) {
  EXPECT_EQ(easiest_level(seen(40, 0, 0.15)), Difficulty::easy);
  EXPECT_EQ(easiest_level(seen(39, 0, 0)), Difficulty::moderate);
  EXPECT_EQ(easiest_level(seen(60, 1, 0)), Difficulty::moderate);
  EXPECT_EQ(easiest_level(seen(60, 0, 0.3)), Difficulty::moderate);
  EXPECT_EQ(easiest_level(seen(60, 2, 0)), Difficulty::hard);
  EXPECT_EQ(easiest_level(seen(60, 0, 0.5)), Difficulty::hard);
}

/// Three cars, one for each level, at 10, 30 and 50 m.
std::vector<ScoredFrame> three_levels(std::vector<Detection> detections) {
  const TruthBoxes truth{{at_level(car(10), Difficulty::easy), at_level(car(30), Difficulty::moderate),
                          at_level(car(50), Difficulty::hard)},
                         {},
                         {}};
  return {{std::move(detections), truth, 700}};
}

TEST(Strata, HarderCarsAreIgnoredNotMissed) {
  const auto frames = three_levels({found(car(10), 3), found(car(50), 2)});
  const Stratum easy{"easy", 0, 1e9, Difficulty::easy}, moderate{"moderate", 0, 1e9, Difficulty::moderate};
  EXPECT_EQ(average_precision(frames, 0.7, easy).boxes, 1);
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7, easy).average_precision, 1);
  EXPECT_EQ(average_precision(frames, 0.7, moderate).boxes, 2);
  EXPECT_NEAR(average_precision(frames, 0.7, moderate).average_precision, 0.5, 1e-12);
  EXPECT_NEAR(average_precision(frames, 0.7, moderate).recall, 0.5, 1e-12);
}

TEST(Strata, RangesSplitBoxesAndFalseAlarms) {
  // The false alarm at 41 m has the highest score: it counts in its own range and in no other.
  const auto frames =
      three_levels({found(car(41), 9), found(car(10), 3), found(car(30), 3), found(car(50), 2)});
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7, {"", 0, 20}).average_precision, 1);
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7, {"", 20, 40}).average_precision, 1);
  EXPECT_NEAR(average_precision(frames, 0.7, {"", 40, 70}).average_precision, 0.5, 1e-12);
  EXPECT_EQ(average_precision(frames, 0.7, {"", 0, 40}).boxes, 2);
}

TEST(Strata, ADetectionAcrossTheEdgeStillFindsItsCar) {
  const std::vector<ScoredFrame> frames = {
      {{found(car(20.1), 1)}, {{at_level(car(19.9), Difficulty::easy)}, {}, {}}}};
  EXPECT_DOUBLE_EQ(average_precision(frames, 0.7, {"", 0, 20}).average_precision, 1);
}

TEST(Strata, AlarmsTooLowForTheLevelCountNeitherWay) {
  // 700 · 1.53 / 60 m = 18 pixels: below every level's limit. 36 pixels at 30 m: below easy's 40.
  const auto far_alarm = three_levels({found(car(60), 9), found(car(10), 3)});
  const auto near_alarm = three_levels({found({30, 20, 4, 2, 0}, 9), found(car(10), 3)});
  const Stratum easy{"easy", 0, 1e9, Difficulty::easy}, hard{"hard"};
  EXPECT_DOUBLE_EQ(average_precision(far_alarm, 0.7, easy).average_precision, 1);
  EXPECT_DOUBLE_EQ(average_precision(near_alarm, 0.7, easy).average_precision, 1);
  EXPECT_LT(average_precision(near_alarm, 0.7, hard).average_precision, 0.3);
}

}  // namespace
}  // namespace mirage
