// A pass over the region that an object changes gives the whole pass's proposals and gradient.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "attack/adversary.h"
#include "attack/observation.h"
#include "base/error.h"
#include "base/files.h"
#include "base/intervals.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "detection/detector_settings.h"
#include "generator/generator.h"
#include "support/small_rig.h"

#ifdef MIRAGE_HAS_FUSION
namespace mirage {
namespace {

/// Relative tolerance of answers, and of gradients in double. In float, a unit with an input near zero may be
/// active in one pass only. Single gradients of either pass then differ more from those in double.
constexpr double kTolerance = 1e-5;
/// In float: tolerance of the median case's gradient, or a multiple of the whole pass's own error.
constexpr double kTolerated = 3e-5, kTimesWhole = 3;

constexpr int kMemory = 2048;  // MB

PreparedFrame generated(std::uint64_t seed) {
  const Rig rig = test::small_rig();
  Frame frame = generate_frame(rig, seed, 0);
  frame.sweep = points_in_view(frame.sweep, frame.calibration);
  return prepare(std::move(frame), rig.lidar);
}

Label car_at(double x, double y, double height = 1.5) {
  Label car;
  car.type = "Car";
  car.box = {{x, y, 3.9, 1.6, 0.3}, -1.73, height};
  return car;
}

/// `memory`: MB for clean frames; 0: whole passes only.
std::unique_ptr<Detector> detector_of(const std::string& name, int memory,
                                      const std::string& defense = "none",
                                      const std::string& precision = "float") {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  DetectorOptions options;
  const std::size_t joint = name.find('+');  // "fusion+ceiling:2"
  options.detector = name.substr(0, joint);
  options.threads = 1;
  options.defense = joint == std::string::npos ? defense : name.substr(joint + 1);
  options.precision = precision;
  options.clean_memory_mb = memory;
  return load_detector(options);
}

double apart(double difference, double norm) {
  return norm > 0 ? std::sqrt(difference / norm) : std::sqrt(difference);
}

/// Answers and gradient of one pass.
struct Answer {
  std::vector<Detection> proposals;
  SensorGradient gradient;
};

/// Places beside the adversary's returns, and a few elsewhere in the sweep.
std::vector<LidarPoint> places_beside(const Simulated& simulated) {
  std::vector<LidarPoint> places;
  const Sweep& sweep = simulated.sweep;
  const std::size_t first = sweep.size() - as_size(simulated.adversary_points);
  for (const std::size_t i : {first / 4, first / 2}) places.push_back(sweep[i]);
  for (std::size_t i = first; i < sweep.size(); i += 7) places.push_back(sweep[i]);
  for (LidarPoint& place : places) place.z += 0.3f;
  return places;
}

/// Relative errors ‖a − b‖ / ‖b‖ of the gradients: pixels in the changed rectangle, the adversary's points,
/// and the presence of further returns.
struct GradientError {
  double pixels = 0, points = 0, presence = 0;
  bool any_pixels = false, any_points = false, any_presence = false;

  GradientError(const SensorGradient& a, const SensorGradient& b, const Simulated& simulated) {
    double difference = 0, norm = 0;
    for (int v = simulated.rect.v0; v < simulated.rect.v1; ++v)
      for (int u = simulated.rect.u0; u < simulated.rect.u1; ++u)
        for (int c = 0; c < 3; ++c) {
          difference += std::pow(a.image.at(u, v, c) - b.image.at(u, v, c), 2);
          norm += std::pow(b.image.at(u, v, c), 2);
        }
    pixels = apart(difference, norm), any_pixels = norm > 0;
    difference = norm = 0;
    const std::size_t first = simulated.sweep.size() - as_size(simulated.adversary_points);
    for (std::size_t i = first; i < simulated.sweep.size(); ++i)
      for (std::size_t c = 0; c < 4; ++c) {
        difference += std::pow(a.points[i][c] - b.points[i][c], 2);
        norm += std::pow(b.points[i][c], 2);
      }
    points = apart(difference, norm), any_points = norm > 0;
    difference = norm = 0;
    EXPECT_EQ(a.presence.size(), b.presence.size());
    for (std::size_t i = 0; i < a.presence.size(); ++i) {
      difference += std::pow(a.presence[i] - b.presence[i], 2);
      norm += std::pow(b.presence[i], 2);
    }
    presence = apart(difference, norm), any_presence = norm > 0;
  }
};

/// The shipped detectors, with local and with whole passes, in float and in double.
class LocalPasses : public testing::TestWithParam<const char*> {
 protected:
  LocalPasses()
      : whole_(detector_of(GetParam(), 0)),
        local_(detector_of(GetParam(), kMemory)),
        whole64_(detector_of(GetParam(), 0, "none", "double")),
        local64_(detector_of(GetParam(), kMemory, "none", "double")) {}

  /// Compares all proposals, and the gradient of a random weighting of proposals with a score above `least`.
  void expect_same(const PreparedFrame& prepared, const Label& host, double least = -1,
                   const TexturedMesh& adversary = random_adversary(3)) {
    const Placement roof = on_roof(BoxRoofFinder().find(prepared.frame, host));
    const Simulated simulated = simulate(prepared, roof, adversary);
    expect_same(prepared, simulated, least);
  }

  void expect_same(const PreparedFrame& prepared, const Simulated& simulated, double least) {
    for (const auto* local : {&local_, &local64_}) ASSERT_EQ((*local)->capabilities().why_whole, "");
    for (const auto* whole : {&whole_, &whole64_}) ASSERT_NE((*whole)->capabilities().why_whole, "");
    const UnchangedInput clean = unchanged_input(prepared, simulated.rect);
    const std::vector<LidarPoint> places = places_beside(simulated);
    SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration, nullptr, places};
    Answer whole{whole_->forward(view, -1, true), {}}, whole64{whole64_->forward(view, -1, true), {}};
    view.clean = &clean;
    Answer local{local_->forward(view, -1, true), {}}, local64{local64_->forward(view, -1, true), {}};
    expect_same(local.proposals, whole.proposals);
    expect_same(local64.proposals, whole64.proposals);
    expect_same(local.proposals, whole64.proposals);

    std::vector<double> weights;
    RandomStream random(7, "weights of proposals");
    for (const Detection& p : whole.proposals) {
      const double weight = random.uniform(-1, 1);
      weights.push_back(p.score() > least ? weight : 0);
    }
    whole.gradient = whole_->backward(weights), local.gradient = local_->backward(weights);
    whole64.gradient = whole64_->backward(weights), local64.gradient = local64_->backward(weights);
    const GradientError exact(local64.gradient, whole64.gradient, simulated),
        now(local.gradient, whole64.gradient, simulated), full(whole.gradient, whole64.gradient, simulated);
    EXPECT_LT(exact.pixels, kTolerance) << "pixels";
    EXPECT_LT(exact.points, kTolerance) << "points";
    EXPECT_LT(exact.presence, kTolerance) << "presence";
    EXPECT_EQ(whole.gradient.presence.size(), whole_->capabilities().knows_presence ? places.size() : 0);
    EXPECT_EQ(exact.any_presence, local_->capabilities().knows_presence);
    if (exact.any_pixels) pixels_.add(exact.pixels, now.pixels, full.pixels);
    if (exact.any_points) points_.add(exact.points, now.points, full.points);
    const bool may_hide_all = std::string(GetParam()).find("ceiling") != std::string::npos;
    EXPECT_TRUE(exact.any_points || simulated.adversary_points == 0 || !local_->capabilities().reads_points ||
                may_hide_all);
  }

  static void expect_same(const std::vector<Detection>& found, const std::vector<Detection>& expected) {
    ASSERT_EQ(found.size(), expected.size());
    double difference = 0, norm = 0, box_difference = 0, box_norm = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
      difference += std::pow(found[i].logit - expected[i].logit, 2), norm += std::pow(expected[i].logit, 2);
      const BevBox &a = found[i].box.bev, &b = expected[i].box.bev;
      for (const auto& [x, y] : {std::pair{a.x, b.x}, {a.y, b.y}, {a.length, b.length}, {a.width, b.width}})
        box_difference += (x - y) * (x - y), box_norm += y * y;
      const PictureBox &p = found[i].picture, &q = expected[i].picture;
      for (const auto& [x, y] : {std::pair{p.left, q.left}, {p.bottom, q.bottom}, {p.right, q.right}})
        box_difference += (x - y) * (x - y), box_norm += y * y;
    }
    EXPECT_LT(apart(difference, norm), kTolerance);
    EXPECT_LT(apart(box_difference, box_norm), kTolerance);
  }

  /// In float a few gradients jump, in whole passes too. Most local ones are as close to double as the whole
  /// pass's.
  void expect_most_close() {
    for (const auto& [what, errors] : {std::pair{"pixels", &pixels_}, {"points", &points_}}) {
      if (errors->exact.empty()) continue;
      const auto largest = [](const std::vector<double>& of) {
        return *std::max_element(of.begin(), of.end());
      };
      std::printf(
          "%s, %zu cases: local and whole in double %.1e apart at most; from the whole pass in double, local "
          "in "
          "float median %.1e, at most %.1e, whole in float median %.1e, at most %.1e\n",
          what, errors->exact.size(), largest(errors->exact), quantile(errors->local, 0.5),
          largest(errors->local), quantile(errors->whole, 0.5), largest(errors->whole));
      std::size_t close = 0;
      for (std::size_t i = 0; i < errors->local.size(); ++i)
        close += errors->local[i] < std::max(kTolerated, kTimesWhole * errors->whole[i]);
      // Under a ceiling, more gradients jump: pixels are close in 7 of 11 cases.
      const bool ceiling = std::string(GetParam()).find("ceiling") != std::string::npos;
      EXPECT_GE(3 * close, (ceiling ? 1.5 : 2) * static_cast<double>(errors->local.size())) << what;
    }
  }

  /// Relative errors of gradients, one per case. exact: local against whole, in double. local, whole: in
  /// float against the whole pass in double.
  struct Errors {
    std::vector<double> exact, local, whole;
    void add(double in_double, double local_float, double whole_float) {
      exact.push_back(in_double), local.push_back(local_float), whole.push_back(whole_float);
    }
  };
  std::unique_ptr<Detector> whole_, local_, whole64_, local64_;
  Errors pixels_, points_;
};

TEST_P(LocalPasses, OfRandomHosts) {
  RandomStream random(5, "random hosts");
  for (int frame = 0; frame < 2; ++frame) {
    const PreparedFrame prepared = generated(31 + static_cast<std::uint64_t>(frame));
    for (int k = 0; k < 2; ++k) {
      const double x = random.uniform(6, 45), y = random.uniform(-0.6, 0.6) * x;
      SCOPED_TRACE(testing::Message() << x << " " << y);
      expect_same(prepared, car_at(x, y), k == 0 ? -1 : 0.1);
    }
  }
  expect_most_close();
}

TEST_P(LocalPasses, NearFarAtBordersAndOverTheHorizon) {
  const PreparedFrame prepared = generated(33);
  for (const auto& [x, y, height] : {std::tuple{3.0, 0.0, 1.5},
                                     {60.0, 3.0, 1.5},
                                     {8.0, 6.8, 1.5},
                                     {8.0, -6.9, 1.5},
                                     {12.0, 0.0, 4.0},
                                     {69.5, 20.0, 1.5},
                                     {30.0, 39.8, 1.5},
                                     {10.0, 3.0, 1.5},
                                     {15.0, -2.0, 1.5},
                                     {20.0, 4.0, 1.5},
                                     {25.0, -6.0, 1.5},
                                     {35.0, 5.0, 1.5},
                                     {45.0, -8.0, 1.5}}) {
    SCOPED_TRACE(testing::Message() << x << " " << y);
    expect_same(prepared, car_at(x, y, height));
  }
  expect_most_close();
}

TEST_P(LocalPasses, OfAnObjectThatTouchesNothing) {
  const PreparedFrame prepared = generated(34);
  expect_same(prepared, car_at(-20, 0));  // behind the camera, and beyond the LiDAR's sector
  Simulated same;
  same.image = prepared.frame.image;
  same.sweep = prepared.frame.sweep;
  expect_same(prepared, same, -1);
}

TEST_P(LocalPasses, OfPointsThatMovedAnywhere) {
  // A larger change than an insertion's: points removed and added in the middle of the sweep.
  const PreparedFrame prepared = generated(35);
  Simulated moved;
  moved.image = prepared.frame.image;
  moved.rect = {100, 20, 131, 51};
  for (int v = moved.rect.v0; v < moved.rect.v1; ++v)
    for (int u = moved.rect.u0; u < moved.rect.u1; ++u) moved.image.at(u, v, (u + v) % 3) = 0.8f;
  moved.sweep = prepared.frame.sweep;
  for (std::size_t i = 0; i < moved.sweep.size(); i += 997) moved.sweep[i].x += 0.3f;
  moved.sweep.erase(moved.sweep.begin() + 50, moved.sweep.begin() + 90);
  expect_same(prepared, moved, -1);
}

TEST_P(LocalPasses, GiveTheSameBitsWhateverIsKept) {
  const PreparedFrame one = generated(36), other = generated(37);
  const auto forgetful = detector_of(GetParam(), 1);  // MB, less than a frame, so that nothing is cached
  const auto logits = [](Detector& detector, const PreparedFrame& prepared) {
    const Label host = car_at(12, 1);
    const Simulated simulated =
        simulate(prepared, on_roof(BoxRoofFinder().find(prepared.frame, host)), random_adversary(4));
    const UnchangedInput clean = unchanged_input(prepared, simulated.rect);
    std::vector<double> all;
    for (const Detection& p : detector.forward(
             {&simulated.image, simulated.sweep, &prepared.frame.calibration, &clean}, -1, false))
      all.push_back(p.logit);
    return all;
  };
  const auto first = logits(*local_, one);
  EXPECT_NE(logits(*local_, other), first);
  EXPECT_EQ(logits(*local_, one), first);
  EXPECT_EQ(logits(*local_->share(), one), first);
  EXPECT_EQ(logits(*forgetful, one), first);
}

INSTANTIATE_TEST_SUITE_P(Detectors, LocalPasses,
                         testing::Values("lidar", "camera", "painted", "fusion", "late", "refined"),
                         [](const auto& one) { return std::string(one.param); });
INSTANTIATE_TEST_SUITE_P(UnderACeiling, LocalPasses, testing::Values("fusion+ceiling:2"),
                         [](const auto&) { return "fusion"; });

TEST_P(LocalPasses, InBfloat16AreNearThoseInFloat) {
  if (!multiplies_bfloat16()) GTEST_SKIP() << "this processor has no bfloat16";
  const PreparedFrame prepared = generated(38);
  const Label host = car_at(12, 1);
  const Simulated simulated =
      simulate(prepared, on_roof(BoxRoofFinder().find(prepared.frame, host)), random_adversary(4));
  const UnchangedInput clean = unchanged_input(prepared, simulated.rect);
  for (const bool whole : {true, false}) {
    const auto rounded = detector_of(GetParam(), whole ? 0 : kMemory, "none", "bfloat16");
    SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration};
    if (!whole) view.clean = &clean;
    const auto expected = whole_->forward(view, -1, true), found = rounded->forward(view, -1, true);
    ASSERT_EQ(found.size(), expected.size());
    double difference = 0, norm = 0, product = 0, a = 0, b = 0;
    for (std::size_t i = 0; i < found.size(); ++i)
      difference += std::pow(found[i].logit - expected[i].logit, 2), norm += std::pow(expected[i].logit, 2);
    // Whole passes round activations and heads too, and that moves the second stage's regions.
    EXPECT_LT(apart(difference, norm), whole ? 0.05 : 0.03) << whole;
    EXPECT_GT(difference, 0) << whole;
    const std::vector<double> ones(found.size(), 1);
    const SensorGradient full = whole_->backward(ones), now = rounded->backward(ones);
    const std::size_t first = simulated.sweep.size() - as_size(simulated.adversary_points);
    for (std::size_t i = first; i < simulated.sweep.size(); ++i)
      for (std::size_t c = 0; c < 3; ++c) {
        product += full.points[i][c] * now.points[i][c];
        a += std::pow(full.points[i][c], 2), b += std::pow(now.points[i][c], 2);
      }
    double pixels = 0, aa = 0, bb = 0;
    for (int v = simulated.rect.v0; v < simulated.rect.v1; ++v)
      for (int u = simulated.rect.u0; u < simulated.rect.u1; ++u)
        for (int c = 0; c < 3; ++c) {
          const double x = full.image.at(u, v, c), y = now.image.at(u, v, c);
          pixels += x * y, aa += x * x, bb += y * y;
        }
    EXPECT_GT(a > 0 ? product / std::sqrt(a * b) : 1, 0.9) << whole;
    // Whole passes retain little of the pixels' gradient of this sum over all proposals.
    if (!whole) {
      EXPECT_GT(aa > 0 ? pixels / std::sqrt(aa * bb) : 1, 0.9);
    }
    EXPECT_GT(a + aa, 0) << whole;
  }
}

TEST(Precision, FallsBackToFloatWithoutTheInstructions) {
  EXPECT_EQ(usable_precision("bfloat16", true), "bfloat16");
  EXPECT_EQ(usable_precision("bfloat16", false), "float");
  EXPECT_EQ(usable_precision("double", false), "double");
  EXPECT_THROW(usable_precision("half", true), InputError);
}

TEST(WholePasses, SayWhyTheyAreWhole) {
  EXPECT_NE(detector_of("fusion", kMemory, "denoising")->capabilities().why_whole.find("non-local"),
            std::string::npos);
  EXPECT_NE(detector_of("fusion", kMemory, "jpeg:50")->capabilities().why_whole.find("compressed"),
            std::string::npos);
  EXPECT_NE(detector_of("lidar", 0)->capabilities().why_whole.find("memory"), std::string::npos);
}

}  // namespace
}  // namespace mirage
#endif
