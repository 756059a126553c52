// The host's side of training: augmentation, order, schedule, and resuming after a stop.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/schedule.h"
#include "detection/car_in_picture.h"
#include "detection/training.h"
#include "generator/dataset.h"
#include "scene/data/kitti.h"
#include "scene/depth/learned_depth.h"
#include "support/files.h"

namespace mirage {
namespace {

/// The same generated frames of a small rig at each call.
void write_frames(const std::filesystem::path& data, int count) {
  const Rig rig = read_rig(std::filesystem::path(MIRAGE_SOURCE) / "tests/faults/small-rig.toml");
  generate_dataset(rig, 1, 0, count, data, [](std::size_t) {});
}

TEST(Training, APoseMovesBoxesWithTheirPoints) {
  const BevBox box{15, -3, 4.2, 1.8, 0.7};
  for (std::uint64_t i = 0; i < 50; ++i) {
    const Eigen::Affine3d pose = random_pose(7, i);
    const BevBox there = moved(box, pose);
    // Mirroring changes the order of a box's corners: compares them as sets.
    for (const Vec2d& corner : corners(box)) {
      const Vec3d p = pose * Vec3d(corner.x(), corner.y(), 0);
      double nearest = 1e9;
      for (const Vec2d& other : corners(there)) nearest = std::min(nearest, (other - p.head<2>()).norm());
      EXPECT_LT(nearest, 1e-9);
    }
    EXPECT_GE(there.length / box.length, 0.949);
    EXPECT_LE(there.length / box.length, 1.051);
  }
}

TEST(Training, TheScheduleRisesAndFalls) {
  EXPECT_LT(one_cycle_rate(1, 0), 0.1);
  EXPECT_DOUBLE_EQ(one_cycle_rate(1, 0.05), 1);
  EXPECT_GT(one_cycle_rate(1, 0.3), one_cycle_rate(1, 0.6));
  EXPECT_NEAR(one_cycle_rate(1, 1), 0.01, 1e-12);
}

TEST(Training, WhatDecidesARunKeepsItsKeys) {
  TrainingOptions options;
  nlohmann::json keys = {{"data", ""},
                         {"rig", ""},
                         {"detector", "fusion"},
                         {"steps", 4000},
                         {"batch", 2},
                         {"learning_rate", 2e-3},
                         {"seed", 0},
                         {"minutes", 0},
                         {"thin_lidar", 0.5},
                         {"joint", false},
                         {"heads", false},
                         {"keep_start", 0},
                         {"ground_truth_sampling", 0}};
  EXPECT_EQ(fields_json(options), keys);
  options.joint = true;
  options.ground_truth_sampling = 2;
  options.thin_lidar = 0;
  options.validate_every = 7;
  keys.update({{"thin_lidar", 0}, {"joint", true}, {"ground_truth_sampling", 2}});
  EXPECT_EQ(fields_json(options), keys);
}

TEST(Training, EveryEpochSeesEveryFrameOnce) {
  const test::TemporaryFolder folder;
  write_frames(folder.path(), 6);
  const TrainingData data(folder.path(), 6, {0, 51.2, -25.6, 25.6}, 3);
  std::vector<std::size_t> first, second;
  for (std::uint64_t i = 0; i < 6; ++i)
    first.push_back(data.frame_of(i)), second.push_back(data.frame_of(6 + i));
  EXPECT_EQ(std::set<std::size_t>(first.begin(), first.end()).size(), 6u);
  EXPECT_EQ(std::set<std::size_t>(second.begin(), second.end()).size(), 6u);
  EXPECT_NE(first, second);
}

TEST(PointsInView, AreThoseThatTheMatrixPutsIntoTheImage) {
  Calibration calibration;
  calibration.camera = {100, 100, 50, 20, 100, 40};
  calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  const Sweep sweep = {{10, 0, 0, 0}, {-10, 0, 0, 0}, {10, 4.9f, 0, 0}, {10, 5.2f, 0, 0}, {10, 0, 3, 0}};
  const auto seen = points_in_view(sweep, calibration);
  ASSERT_EQ(seen.size(), 2u);
  const auto m = pixel_from_velo(calibration);
  const LidarPoint& p = seen[1];
  const double w = m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11];
  EXPECT_NEAR((m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3]) / w, 1, 1e-5);
}

TEST(Training, AShareOfNoStartIsRefused) {
  TrainingOptions options;
  options.keep_start = 0.25;
  EXPECT_THAT(test::error_text<FieldError>([&] { train_detector(options); }),
              testing::StartsWith("keep_start: needs weights to start from"));
}

TEST(Training, OptionsThatTheDetectorDoesNotHaveAreRefused) {
  const auto text = [](const std::string& detector, const std::function<void(TrainingOptions&)>& set) {
    TrainingOptions options;
    options.detector = detector;
    options.start = "start.weights";
    set(options);
    return test::error_text<FieldError>([&] { train_detector(options); });
  };
  const auto lidar = [](TrainingOptions& o) { o.lidar = "lidar.weights"; };
  const auto camera = [](TrainingOptions& o) { o.camera = "camera.weights"; };
  const auto joint = [](TrainingOptions& o) { o.joint = true; };
  const auto heads = [](TrainingOptions& o) { o.heads = true; };
  EXPECT_THAT(text("lidar", lidar), testing::StartsWith("lidar: has no effect on the detector lidar; "));
  EXPECT_THAT(text("lidar", camera), testing::StartsWith("camera: has no effect on the detector lidar; "));
  EXPECT_THAT(text("lidar", joint), testing::StartsWith("joint: has no effect on the detector lidar; "));
  EXPECT_THAT(text("camera", camera), testing::StartsWith("camera: has no effect on the detector camera; "));
  EXPECT_THAT(text("fusion", heads), testing::StartsWith("heads: has no effect on the detector fusion; "));
  EXPECT_THAT(text("fusion",
                   [](TrainingOptions& o) {
                     o.joint = true;
                     o.start.clear();
                   }),
              testing::StartsWith("joint: trains what other weights gave"));
  EXPECT_THAT(text("camera",
                   [](TrainingOptions& o) {
                     o.heads = true;
                     o.start.clear();
                   }),
              testing::StartsWith("heads: trains a part of weights"));
}

TEST(Training, FramesCountByWhatTheyHold) {
  const test::TemporaryFolder folder;
  Frame frame;
  frame.id = "000000";
  frame.calibration.camera = {80, 80, 55.5, 30, 112, 64};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.image = ImageF(112, 64, 3, 0.3f);
  frame.sweep = {{10, 0, 0, 0.5f}};
  const std::vector<std::string> ids = {frame.id};
  const auto hash = [&] { return training_frames_hash(folder.path(), ids); };
  write_frame(folder.path(), frame);
  const std::string first = hash();
  EXPECT_EQ(hash(), first);
  write_depth_png(true_depth_file(folder.path(), frame.id), ImageF(112, 64, 1, 5));
  const std::string with_depth = hash();
  EXPECT_NE(with_depth, first);
  frame.sweep.push_back({11, 0, 0, 0.5f});
  write_frame(folder.path(), frame);
  EXPECT_NE(hash(), with_depth);
}

#ifdef MIRAGE_HAS_FUSION
TEST(Training, AStoppedRunGoesOnToTheSameWeights) {
  const test::TemporaryFolder base;
  write_frames(base / "data", 2);
  TrainingOptions options;
  options.data = base / "data";
  options.detector = "lidar";
  options.frames = 2;
  options.steps = 4;
  options.batch = 1;
  options.quiet = true;
  options.checkpoint.steps = 2;
  options.validation = options.data;
  options.validation_frames = 1;
  options.validate_every = 2;
  options.out = base / "whole";
  const TrainingResult whole = train_detector(options);

  // The run after two steps: its state and its checkpoint, copied before it continued.
  options.out = base / "parts";
  options.steps = 4;
  make_output_folder(options.out);
  {
    DetectorOptions load{"lidar", {}, true, options.seed, 1};
    const auto detector = load_detector(load);
    TrainingData data(options.data, options.frames, detector->region(), options.seed, 0, false,
                      options.thin_lidar);
    for (std::int64_t step = 0; step < 2; ++step) {
      const auto samples = data.prepare(step, 1);
      const std::vector<TrainingSample> views = {samples[0].view()};
      detector->train_step(views, one_cycle_rate(options.learning_rate, static_cast<double>(step) / 4));
    }
    detector->save(options.out / "checkpoint-2.weights", true);
    auto state = read_json(base / "whole" / "training.json");
    state["step"] = 2;
    write_file(options.out / "training.jsonl", read_file(base / "whole" / "training.jsonl"));
    state["weights"] = "checkpoint-2.weights";
    write_json(options.out / "training.json", state);
  }
  const TrainingResult parts = train_detector(options);
  EXPECT_EQ(parts.steps, 4);
  EXPECT_EQ(read_file(whole.weights), read_file(parts.weights));
  // Each step is in the log once, although steps 3 and 4 were there before the stop.
  const std::string log = read_file(options.out / "training.jsonl");
  EXPECT_EQ(log.find("\"step\":2"), log.rfind("\"step\":2"));
  EXPECT_NE(log.find("\"ap50\""), std::string::npos);

  for (auto change : {+[](TrainingOptions& o) { o.learning_rate = 1e-4; },
                      +[](TrainingOptions& o) { o.precision = "bfloat16"; },
                      +[](TrainingOptions& o) { o.start = o.out / "checkpoint-4.weights"; }}) {
    TrainingOptions other = options;
    change(other);
    EXPECT_THROW(train_detector(other), InputError);
  }
}
#endif

}  // namespace
}  // namespace mirage
