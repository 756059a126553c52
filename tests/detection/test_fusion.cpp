// The fusion plugin: exact gradients through both sensors, robustness, learning.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "detection/detector.h"
#include "detection/detector_settings.h"

#ifdef MIRAGE_HAS_FUSION
namespace mirage {
namespace {

/// The detector's proposals: one per cell of 0.5 m, 0…70 m × ±40 m.
constexpr std::size_t kRows = 140, kColumns = 160;
constexpr double kCell = 0.5;

/// A ground plane and one car in front of a small camera.
struct Street {
  ImageF image{320, 96, 3};
  std::vector<LidarPoint> points;
  Calibration calibration;
  BevBox box{14, 1, 4, 1.7, 0.2};

  Street() {
    calibration.camera = {180, 180, 160, 45, 320, 96};
    calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    RandomStream random(3, "street");
    for (float& value : image.data) value = static_cast<float>(random.uniform(0.05, 0.9));
    for (int i = 0; i < 1500; ++i)
      points.push_back({static_cast<float>(random.uniform(5, 45)), static_cast<float>(random.uniform(-4, 4)),
                        static_cast<float>(random.uniform(-1.78, -1.62)), 0});
    for (int i = 0; i < 300; ++i) {
      const double along = random.uniform(-2, 2), up = random.uniform(0.2, 1.5);
      points.push_back({static_cast<float>(box.x + along * std::cos(box.yaw) + 0.85 * std::sin(box.yaw)),
                        static_cast<float>(box.y + along * std::sin(box.yaw) - 0.85 * std::cos(box.yaw)),
                        static_cast<float>(up - 1.7), 0.3f});
    }
  }
  SensorView view() const { return {&image, points, &calibration}; }
  TrainingSample sample() const {
    TrainingSample made;
    made.input = view();
    made.boxes = {box};
    return made;
  }
};

std::unique_ptr<Detector> fresh(const std::string& name = "fusion", std::uint64_t seed = 1, int threads = 1) {
  DetectorOptions options;
  options.detector = name;
  options.fresh = true;
  options.seed = seed;
  options.threads = threads;
  return load_detector(options);
}

/// Trained for a few steps: after initialisation the head's weights are tiny, and so are the gradients.
std::unique_ptr<Detector> trained(const Street& street, const std::string& name = "fusion") {
  auto detector = fresh(name);
  const std::vector<TrainingSample> samples = {street.sample()};
  for (int i = 0; i < 8; ++i) detector->train_step(samples, 2e-3);
  return detector;
}

/// Weights of a scalar objective over all proposals (threshold 0 keeps every cell, in a fixed order).
std::vector<double> weights_near(const std::vector<Detection>& proposals, const BevBox& box) {
  std::vector<double> weights;
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const double row = std::floor(static_cast<double>(i) / kColumns);
    const double x = kCell * (row + 0.5), y = -40 + kCell * (static_cast<double>(i % kColumns) + 0.5);
    weights.push_back(std::hypot(x - box.x, y - box.y) < 2 ? 1 : 0);
  }
  return weights;
}

double objective(Detector& detector, const Street& street, const std::vector<double>& weights) {
  const auto proposals = detector.forward(street.view(), -1, false);
  double sum = 0;
  for (std::size_t i = 0; i < proposals.size(); ++i) sum += weights[i] * proposals[i].logit;
  return sum;
}

SensorGradient gradient_of(Detector& detector, const Street& street, std::vector<double>& weights) {
  const auto proposals = detector.forward(street.view(), -1, true);
  EXPECT_EQ(proposals.size(), kRows * kColumns);
  weights = weights_near(proposals, street.box);
  return detector.backward(weights);
}

/// Central difference along the gradient itself, where the signal is largest against float rounding. The step
/// with the best agreement counts. A long step may cross kinks, whose places differ between processors; a
/// short one is lost in rounding. A wrong gradient agrees with none.
void check_along(Detector& detector, const Street& street, const std::vector<double>& weights,
                 const std::function<void(Street&, double)>& move, double expected, double step) {
  double best = HUGE_VAL;
  for (const double part : {1.0, 0.5, 2.0}) {
    Street above = street, below = street;
    move(above, part * step);
    move(below, -part * step);
    const double numeric =
        (objective(detector, above, weights) - objective(detector, below, weights)) / (2 * part * step);
    if (std::abs(numeric / expected - 1) < std::abs(best - 1)) best = numeric / expected;
    if (std::abs(best - 1) <= 0.05) break;
  }
  EXPECT_NEAR(best, 1, 0.05) << "analytic " << expected;
}

TEST(Fusion, PointGradientMatchesDifferencesWithTheImageFixed) {
  for (const char* name : {"fusion", "lidar"}) {
    const Street street;
    const auto detector = trained(street, name);
    std::vector<double> weights;
    const SensorGradient gradient = gradient_of(*detector, street, weights);
    double square = 0;
    for (const auto& d : gradient.points) {
      for (std::size_t a = 0; a < 3; ++a) square += d[a] * d[a];
      EXPECT_EQ(d[3], 0);  // reflectance is not read
    }
    const double norm = std::sqrt(square);
    ASSERT_TRUE(std::isfinite(norm));
    ASSERT_GT(norm, 1e-3) << name;
    check_along(
        *detector, street, weights,
        [&](Street& moved, double step) {
          for (std::size_t i = 0; i < moved.points.size(); ++i) {
            moved.points[i].x += static_cast<float>(step * gradient.points[i][0] / norm);
            moved.points[i].y += static_cast<float>(step * gradient.points[i][1] / norm);
            moved.points[i].z += static_cast<float>(step * gradient.points[i][2] / norm);
          }
        },
        norm, 2e-3);
  }
}

TEST(Fusion, ImageGradientMatchesDifferencesWithThePointsFixed) {
  const Street street;
  const auto detector = trained(street);
  std::vector<double> weights;
  const SensorGradient gradient = gradient_of(*detector, street, weights);
  double square = 0;
  for (float d : gradient.image.data) square += static_cast<double>(d) * d;
  const double norm = std::sqrt(square);
  ASSERT_TRUE(std::isfinite(norm));
  ASSERT_GT(norm, 1e-3);
  check_along(
      *detector, street, weights,
      [&](Street& moved, double step) {
        for (std::size_t i = 0; i < moved.image.data.size(); ++i)
          moved.image.data[i] += static_cast<float>(step * gradient.image.data[i] / norm);
      },
      norm, 1e-2);
}

TEST(Fusion, PointsAlsoMoveTheirImageFeatures) {
  // The same network and points: without the picture's contribution the gradient differs.
  const Street street;
  Street grey = street;
  for (float& value : grey.image.data) value = 0.4f;
  const auto detector = trained(street);
  std::vector<double> weights;
  const SensorGradient textured = gradient_of(*detector, street, weights);
  const SensorGradient plain = gradient_of(*detector, grey, weights);
  double difference = 0;
  for (std::size_t i = 0; i < textured.points.size(); ++i)
    for (std::size_t a = 0; a < 3; ++a) difference += std::abs(textured.points[i][a] - plain.points[i][a]);
  EXPECT_GT(difference, 1e-3);
}

TEST(Fusion, LidarDetectorHasNoImageGradient) {
  const Street street;
  const auto detector = trained(street, "lidar");
  std::vector<double> weights;
  for (float d : gradient_of(*detector, street, weights).image.data) ASSERT_EQ(d, 0);
}

TEST(Fusion, TheSameInputGivesTheSameOutput) {
  const Street street;
  const auto detector = trained(street);
  const auto first = detector->forward(street.view(), -1, false),
             second = detector->forward(street.view(), -1, true);
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t i = 0; i < first.size(); ++i) ASSERT_EQ(first[i].logit, second[i].logit);
}

/// The message of the exception that `work` throws.
std::string problem_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const std::exception& problem) {
    return problem.what();
  }
  return "";
}

TEST(Fusion, ABrokenNetworkIsAnError) {
  const Street street;
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_broken_" + std::to_string(getpid()) + ".weights";
  for (const char* name : {"lidar", "camera"}) {
    fresh(name)->save(file, false);
    std::string bytes = read_file(file);
    std::uint64_t header = 0;
    std::memcpy(&header, bytes.data(), sizeof header);
    for (std::size_t at = sizeof header + header; at < bytes.size(); at += sizeof(float)) {  // all is F32
      float value = 0;
      std::memcpy(&value, bytes.data() + at, sizeof value);
      value *= 1e30f;
      std::memcpy(bytes.data() + at, &value, sizeof value);
    }
    write_file(file, bytes);
    DetectorOptions options;
    options.detector = name;
    options.weights = file;
    const auto broken = load_detector(options);
    EXPECT_THAT(problem_of([&] { broken->forward(street.view(), 0.1, false); }),
                ::testing::HasSubstr("a logit that is not finite"))
        << name;
  }
  std::filesystem::remove(file);
}

TEST(Fusion, AStepToWeightsThatAreNotFiniteIsAnError) {
  const Street street;
  const std::vector<TrainingSample> samples = {street.sample()};
  const auto detector = fresh("lidar");
  EXPECT_THAT(problem_of([&] { detector->train_step(samples, HUGE_VAL); }),
              ::testing::HasSubstr("the weights are not finite after the step; lower the learning rate"));
}

TEST(Fusion, ANetworkOfWhichNothingLearnsIsAnError) {
  const Street street;
  const std::vector<TrainingSample> samples = {street.sample()};
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_whole_" + std::to_string(getpid()) + ".weights";
  fresh("lidar")->save(file, false);
  DetectorOptions options;
  options.detector = "lidar";
  options.fresh = true;
  options.lidar = file;
  const auto detector = load_detector(options);
  EXPECT_THAT(problem_of([&] { detector->train_step(samples, 1e-3); }),
              ::testing::HasSubstr("nothing of the network learns"));
  std::filesystem::remove(file);
}

TEST(Fusion, OddInputsGiveFiniteGradients) {
  const auto detector = fresh();
  Street empty, outside, tiny, stacked;
  empty.points.clear();
  outside.points = {{-5, 0, 0, 0}, {500, 0, 0, 0}, {10, 0, 40, 0}, {0.001f, 0, 0, 0}, {10, -40, 0, 0}};
  outside.points.push_back({std::nanf(""), 1, 1, 0});
  tiny.image = ImageF(3, 2, 3);
  stacked.points.assign(500, LidarPoint{12, 0, -1, 0});
  Street black;
  for (float& value : black.image.data) value = 0;
  for (const Street* street : {&empty, &outside, &tiny, &stacked, &black}) {
    std::vector<double> weights;
    const SensorGradient gradient = gradient_of(*detector, *street, weights);
    EXPECT_EQ(gradient.points.size(), street->points.size());
    for (float d : gradient.image.data) ASSERT_TRUE(std::isfinite(d));
    for (const auto& d : gradient.points)
      for (float value : d) ASSERT_TRUE(std::isfinite(value));
  }
}

TEST(Fusion, OverfitsOneFrameAndFindsItsCar) {
  const Street street;
  const auto detector = fresh();
  const std::vector<TrainingSample> samples = {street.sample()};
  double first = 0, last = 0;
  constexpr int steps = 45;
  for (int i = 0; i < steps; ++i) {
    const TrainingLoss loss = detector->train_step(samples, 3e-3);
    (i < 3 ? first : last) += i < 3 ? loss.total / 3 : i >= steps - 5 ? loss.total / 5 : 0;
  }
  // At the end of a schedule norms are frozen: the network then learns with the norms that it will use.
  for (int i = 0; i < 25; ++i) detector->train_step(samples, 6e-4);
  EXPECT_LT(last, first / 3);
  const auto found = suppress(detector->forward(street.view(), 0.1, false));
  ASSERT_FALSE(found.empty());
  EXPECT_GT(iou(found[0].box.bev, street.box), 0.5);
}

TEST(Fusion, ThreadsChangeNothing) {
  const Street street;
  Street other;
  other.box.y += 0.5;
  const std::vector<TrainingSample> samples = {street.sample(), other.sample()};
  const auto one = fresh("fusion", 4, 1), two = fresh("fusion", 4, 2);
  for (int i = 0; i < 3; ++i)
    EXPECT_EQ(one->train_step(samples, 1e-3).total, two->train_step(samples, 1e-3).total) << i;
}

TEST(Fusion, SavingAndLoadingGoesOnWhereItStopped) {
  const Street street;
  const std::vector<TrainingSample> samples = {street.sample()};
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_fusion_" + std::to_string(getpid()) + ".weights";
  const auto detector = trained(street);
  detector->save(file, true);
  DetectorOptions options;
  options.weights = file;
  options.seed = 1;
  const auto again = load_detector(options);
  for (int i = 0; i < 3; ++i)
    EXPECT_EQ(detector->train_step(samples, 1e-3).total, again->train_step(samples, 1e-3).total) << i;

  options.detector = "lidar";
  try {
    load_detector(options);
    ADD_FAILURE() << "fusion weights were taken for lidar";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("weights of a fusion detector"));
  }
  options.detector = "fusion";
  const std::string bytes = read_file(file);
  for (const std::string& damaged : {bytes.substr(0, bytes.size() / 2), std::string("not weights at all")}) {
    write_file(file, damaged);
    try {
      load_detector(options);
      ADD_FAILURE() << "damaged weights were taken";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), ::testing::HasSubstr("not a readable weights file"));
      EXPECT_THAT(error.what(), ::testing::HasSubstr(file.string()));
    }
  }
  std::filesystem::remove(file);
}

TEST(Fusion, StartsFromALidarDetectorWithAPictureThatSpeaksAtOnce) {
  const Street street;
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_start_" + std::to_string(getpid()) + ".weights";
  const auto lidar = trained(street, "lidar");
  lidar->save(file, true);
  const auto expected = lidar->forward(street.view(), -1, false);
  const std::vector<TrainingSample> samples = {street.sample()};
  for (const char* name : {"fusion", "painted", "late"}) {
    DetectorOptions options{name, file, false, 1, 1};
    options.start = true;
    const auto joined = load_detector(options);
    SensorView blind = street.view();
    blind.image = nullptr;
    double alone = 0, together = 0;
    const auto without = joined->forward(blind, -1, false);
    for (std::size_t i = 0; i < without.size(); ++i)
      alone = std::max(alone, std::abs(without[i].logit - expected[i].logit));
    EXPECT_LT(alone, 1e-5) << name;  // without a picture it is that detector
    const auto with = joined->forward(street.view(), -1, false);
    for (std::size_t i = 0; i < with.size(); ++i)
      together = std::max(together, std::abs(with[i].logit - expected[i].logit));
    EXPECT_GT(together, 1e-3) << name;  // nothing is suppressed
    EXPECT_TRUE(std::isfinite(joined->train_step(samples, 1e-3).total)) << name;
  }

  // A new training resets the optimiser; a resumed one does not.
  DetectorOptions options = {"lidar", file, false, 1, 1};
  const auto going_on = load_detector(options);
  options.start = true;
  const auto anew = load_detector(options);
  EXPECT_EQ(lidar->train_step(samples, 1e-3).total, going_on->train_step(samples, 1e-3).total);
  anew->train_step(samples, 1e-3);
  EXPECT_EQ(lidar->train_step(samples, 1e-3).total, going_on->train_step(samples, 1e-3).total);
  EXPECT_NE(lidar->train_step(samples, 1e-3).total, anew->train_step(samples, 1e-3).total);

  // A lidar detector has no use for a fusion detector's weights.
  trained(street)->save(file, false);
  EXPECT_THROW(load_detector(options), InputError);
  std::filesystem::remove(file);
}

TEST(Fusion, BranchesThatAreTakenOverStayAsTheyAre) {
  const Street street;
  const std::string own = ::testing::TempDir() + "mirage_branch_" + std::to_string(getpid());
  trained(street, "lidar")->save(own + ".lidar", false);
  trained(street, "camera")->save(own + ".camera", false);
  DetectorOptions options{"late", {}, true, 1, 1};
  options.lidar = own + ".lidar";
  options.camera = own + ".camera";
  const auto late = load_detector(options);
  const auto lidar = load_detector({"lidar", own + ".lidar", false, 1, 1});
  TrainingSample sample = street.sample();
  sample.picture_key = 7;  // the second step reads the first one's cached features
  const std::vector<TrainingSample> samples = {sample};
  for (int i = 0; i < 3; ++i) late->train_step(samples, 1e-2);
  SensorView blind = street.view();
  blind.image = nullptr;
  const auto before = lidar->forward(blind, -1, false), after = late->forward(blind, -1, false);
  ASSERT_EQ(before.size(), after.size());
  for (std::size_t i = 0; i < before.size(); ++i) ASSERT_EQ(before[i].logit, after[i].logit);
  options.camera = own + ".lidar";
  EXPECT_THROW(load_detector(options), InputError);
  for (const char* part : {".lidar", ".camera"}) std::filesystem::remove(own + part);
}

TEST(Fusion, ASecondStageLearnsAloneOnAFirstOne) {
  const Street street;
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_first_" + std::to_string(getpid()) + ".weights";
  const auto first = trained(street, "fusion");
  first->save(file, false);
  DetectorOptions options{"refined", file, false, 1, 1};
  options.start = true;
  const auto refined = load_detector(options);
  const auto same = [&](const SensorView& view, double most) {
    const auto expected = first->forward(view, -1, false), found = refined->forward(view, -1, false);
    double apart = 0;
    for (std::size_t i = 0; i < found.size(); ++i)
      apart = std::max({apart, std::abs(found[i].logit - expected[i].logit),
                        std::abs(found[i].box.bev.x - expected[i].box.bev.x)});
    EXPECT_EQ(found.size(), expected.size());
    EXPECT_LE(apart, most);
    return apart;
  };
  same(street.view(), 1e-4);  // it starts as the first stage
  const std::vector<TrainingSample> samples = {street.sample()};
  double before = 0, after = 0;
  for (int i = 0; i < 40; ++i) (i == 0 ? before : after) = refined->train_step(samples, 3e-3).total;
  EXPECT_LT(after, 0.7 * before);
  EXPECT_GT(same(street.view(), 1e9), 1e-2);
  SensorView blind = street.view();
  blind.image = nullptr;
  same(blind, 0);  // without a picture it equals the first stage, which is unchanged

  // Saved and loaded it is the same, and training continues on its own part only.
  const std::filesystem::path own = file.string() + ".refined";
  refined->save(own, false);
  const auto again = load_detector({"refined", own, false, 1, 1});
  const auto expected = refined->forward(street.view(), -1, false),
             found = again->forward(street.view(), -1, false);
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) ASSERT_EQ(found[i].logit, expected[i].logit);
  again->train_step(samples, 1e-3);
  EXPECT_EQ(again->forward(blind, -1, false)[7].logit, first->forward(blind, -1, false)[7].logit);
  // Each refuses the other's weights.
  EXPECT_THROW(load_detector({"refined", file, false, 1, 1}), InputError);
  EXPECT_THROW(load_detector({"fusion", own, false, 1, 1}), InputError);
  std::filesystem::remove(file);
  std::filesystem::remove(own);
}

TEST(Fusion, TellsWhatItReadsAndFinds) {
  const auto can = [](const char* name) { return fresh(name)->capabilities(); };
  EXPECT_FALSE(can("lidar").reads_image);
  EXPECT_TRUE(can("camera").finds_picture);
  EXPECT_FALSE(can("camera").reads_points);
  EXPECT_FALSE(can("camera").finds_bev);
  for (const char* name : {"painted", "fusion", "late", "refined"}) {
    EXPECT_TRUE(can(name).reads_image && can(name).reads_points && can(name).finds_bev) << name;
    EXPECT_FALSE(can(name).finds_picture) << name;
  }
}

TEST(Fusion, TheCameraDetectorLearnsAndSeesPixelsAlone) {
  Street street;
  for (float& value : street.image.data) value *= 0.3f;
  for (int v = 30; v < 60; ++v)
    for (int u = 100; u < 160; ++u)
      for (int c = 0; c < 3; ++c) street.image.at(u, v, c) = 0.9f;
  TrainingSample sample = street.sample();
  sample.picture_boxes = {{100, 30, 160, 60}};
  std::vector<std::uint8_t> mask(std::size_t{320} * 96, 0);
  for (int v = 30; v < 60; ++v) std::fill_n(mask.begin() + v * 320 + 100, 60, std::uint8_t{1});
  sample.vehicle_mask = mask;
  const std::vector<TrainingSample> samples = {sample};
  const auto detector = fresh("camera");
  double first = 0, last = 0;
  for (int i = 0; i < 30; ++i) (i == 0 ? first : last) = detector->train_step(samples, 5e-4).total;
  EXPECT_LT(last, 0.8 * first);
  const auto all = detector->forward(street.view(), -1, true);
  const SensorGradient gradient = detector->backward(std::vector<double>(all.size(), 1));
  double pixels = 0;
  for (float d : gradient.image.data) pixels += std::abs(d);
  EXPECT_GT(pixels, 1e-4);
  for (const auto& d : gradient.points) EXPECT_EQ(d, (std::array<float, 4>{}));
}

TEST(Fusion, LearnsInBfloat16WithWeightsInFloat) {
  const Street street;
  for (const char* name : {"lidar", "camera", "painted", "fusion", "late", "refined"}) {
    DetectorOptions options{name, {}, true, 1, 1};
    const auto exact = load_detector(options);
    options.precision = "bfloat16";
    const auto rounded = load_detector(options);
    // No boxes in the picture: rounding may change which places are matched to a box.
    const std::vector<TrainingSample> samples = {street.sample()};
    for (int i = 0; i < 3; ++i) {
      const double a = exact->train_step(samples, 2e-4).total, b = rounded->train_step(samples, 2e-4).total;
      // A fresh camera network, without norms, diverges after the first step.
      if (i == 0 || name == std::string("lidar")) {
        EXPECT_NEAR(a, b, 0.05 * a + 0.2) << name << ' ' << i;
      }
      EXPECT_TRUE(std::isfinite(b)) << name;
      // Without bfloat16 instructions both are in float, equal to the bit.
      EXPECT_EQ(a != b, multiplies_bfloat16()) << name << ' ' << a << ' ' << b;
    }
  }
}

TEST(Fusion, PartsAreAddedAndStayWithTheWeights) {
  const Street street;
  const std::filesystem::path file =
      ::testing::TempDir() + "mirage_parts_" + std::to_string(getpid()) + ".weights";
  const auto plain = trained(street);
  plain->save(file, false);
  const auto logits = [&](Detector& detector) {
    std::vector<double> values;
    for (const Detection& p : detector.forward(street.view(), -1, false)) values.push_back(p.logit);
    return values;
  };
  DetectorOptions options{"fusion", file, false, 1, 1};
  options.start = true;
  options.parts = {"denoising"};
  const auto denoising = load_detector(options);
  EXPECT_NE(logits(*denoising), logits(*plain));
  options.parts = {"denoising", "depth-gate"};
  const auto both = load_detector(options);
  EXPECT_NE(logits(*both), logits(*plain));  // many of this street's random returns lie in front of others
  const std::vector<TrainingSample> samples = {street.sample()};
  for (int i = 0; i < 3; ++i) both->train_step(samples, 1e-3);
  both->save(file, false);
  const auto again = load_detector({"fusion", file, false, 2, 1});
  EXPECT_EQ(logits(*again), logits(*both));
  options.parts = {"armour"};
  EXPECT_THROW(load_detector(options), InputError);
  std::filesystem::remove(file);
}

TEST(Fusion, SharesItsWeightsWithAnotherThreadsInstance) {
  const Street street;
  const auto detector = trained(street);
  const auto other = detector->share();
  ASSERT_TRUE(other);
  std::vector<double> weights;
  const auto compare = [&] {
    const SensorGradient a = gradient_of(*detector, street, weights),
                         b = gradient_of(*other, street, weights);
    EXPECT_EQ(a.image.data, b.image.data);
    EXPECT_EQ(a.points, b.points);
  };
  compare();
  const double before = objective(*other, street, weights);
  const std::vector<TrainingSample> samples = {street.sample()};
  detector->train_step(samples, 1e-3);
  EXPECT_NE(objective(*other, street, weights), before);
  compare();
}

TEST(Fusion, TellsHowStronglyTheImageFeaturesAnswer) {
  const Street street;
  const auto detector = fresh();
  const ImageFeatures features = detector->image_features(street.view());
  EXPECT_EQ(features.stride, 8);
  EXPECT_EQ(features.map.width, 320 / 8);
  EXPECT_EQ(features.map.height, 96 / 8);
  EXPECT_EQ(features.bev.width, static_cast<int>(kRows));
  EXPECT_EQ(features.bev.height, static_cast<int>(kColumns));
  EXPECT_EQ(features.cell, kCell);
  EXPECT_GT(*std::max_element(features.map.data.begin(), features.map.data.end()), 0);
  // Projected to where there are points: 5–45 m ahead, 4 m to each side, and the reach of 1.5 m.
  for (int row = 0; row < features.bev.height; ++row)
    for (int column = 0; column < features.bev.width; ++column) {
      const double x = kCell * (column + 0.5), y = -40 + kCell * (row + 0.5);
      const float value = features.bev.at(column, row, 0);
      if (x < 3.5 || x > 46.5 || std::abs(y) > 5.5) {
        EXPECT_EQ(value, 0) << x << ", " << y;
      }
      // Dense returns inside the picture: the ground at 12 m.
      if (std::abs(x - 12) < 1 && std::abs(y) < 2) {
        EXPECT_GT(value, 0) << x << ", " << y;
      }
    }
  EXPECT_EQ(fresh("lidar")->image_features(street.view()).stride, 0);
}

TEST(Fusion, BackwardNeedsAGraph) {
  const Street street;
  const auto detector = fresh();
  detector->forward(street.view(), 0.1, false);
  EXPECT_THROW(detector->backward({}), Failure);
}

}  // namespace
}  // namespace mirage
#endif
