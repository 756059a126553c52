// Detectors exported from PyTorch: values and gradients of a valid one, and one clear line for each error.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "detection/detector.h"
#include "support/files.h"

#ifdef MIRAGE_HAS_TORCHSCRIPT

namespace mirage {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

const std::filesystem::path& models() {
  static const test::TemporaryFolder folder;
  static const int status =
      std::system((MIRAGE_BUILD "/test_plugins/torchscript_models " + folder.path().string()).c_str());
  EXPECT_EQ(status, 0);
  return folder.path();
}

std::unique_ptr<Detector> load(const std::string& model) {
  DetectorOptions options;
  options.detector = "torchscript";
  options.weights = models() / (model + ".pt");
  options.threads = 1;
  return load_detector(options);
}

std::string load_error(const std::string& model) {
  const std::string text = test::error_text<InputError>([&] { load(model); });
  EXPECT_THAT(text, Not(HasSubstr("\n")));
  EXPECT_THAT(text, HasSubstr(model + ".pt: "));
  return text;
}

struct SmallScene {
  ImageF image{60, 30, 3};
  std::vector<LidarPoint> points;
  Calibration calibration;
  SmallScene() {
    RandomStream random(3, "torchscript scene");
    for (float& value : image.data) value = static_cast<float>(random.uniform());
    // Bilinear look-ups have a kink at whole pixels, where central differences are meaningless.
    const auto off_kink = [](double pixel) { return std::abs(pixel - std::round(pixel)) > 0.05; };
    while (points.size() < 12) {
      const double x = random.uniform(8, 22), y = random.uniform(-0.2, 0.2) * x,
                   z = random.uniform(-1.5, 0.5);
      if (off_kink(60 * y / x) && off_kink(60 * z / x))
        points.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(z),
                          static_cast<float>(random.uniform())});
    }
    calibration.camera = {60, 60, 30, 10, 60, 30};
    calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  }
  SensorView view() const { return {&image, points, &calibration}; }
};

double objective(Detector& detector, const SmallScene& scene) {
  const auto found = detector.forward(scene.view(), -1, false);
  return 1.0 * found[0].logit - 0.5 * found[1].logit + 2.0 * found[2].logit;
}

TEST(TorchScript, RunsAModelAndReadsItsRegion) {
  const auto detector = load("works");
  EXPECT_EQ(detector->name(), "torchscript");
  EXPECT_EQ(detector->region(), (std::array<double, 4>{0, 50, -20, 20}));
  const SmallScene scene;
  const auto found = detector->forward(scene.view(), -1, false);
  ASSERT_EQ(found.size(), 3u);
  EXPECT_FLOAT_EQ(static_cast<float>(found[1].box.bev.yaw), 0.3f);
  EXPECT_EQ(found[2].box.bev.x, 20);
  // Proposals at or below the threshold are dropped, the rest keeps its order.
  const double middle = std::max({found[0].score(), found[1].score(), found[2].score()}) - 1e-9;
  EXPECT_EQ(detector->forward(scene.view(), middle, false).size(), 1u);
}

TEST(TorchScript, GradientsMatchCentralDifferences) {
  const auto detector = load("works");
  const SmallScene scene;
  ASSERT_EQ(detector->forward(scene.view(), -1, true).size(), 3u);
  const std::vector<double> d_logits = {1, -0.5, 2};
  const SensorGradient gradient = detector->backward(d_logits);
  const auto check = [&](double analytic, double step, const auto& value) {
    SmallScene above = scene, below = scene;
    value(above) += static_cast<float>(step);
    value(below) -= static_cast<float>(step);
    const double numeric = (objective(*detector, above) - objective(*detector, below)) / (2 * step);
    EXPECT_NEAR(analytic, numeric, 2e-3 + 0.02 * std::abs(numeric));
  };
  for (std::size_t i = 0; i < scene.points.size(); ++i) {
    check(gradient.points[i][0], 2e-3, [i](SmallScene& s) -> float& { return s.points[i].x; });
    check(gradient.points[i][1], 2e-3, [i](SmallScene& s) -> float& { return s.points[i].y; });
    check(gradient.points[i][2], 2e-3, [i](SmallScene& s) -> float& { return s.points[i].z; });
    check(gradient.points[i][3], 1e-2, [i](SmallScene& s) -> float& { return s.points[i].reflectance; });
  }
  double largest = 0;
  for (std::size_t k = 0; k < scene.image.data.size(); ++k) {
    largest = std::max(largest, std::abs(static_cast<double>(gradient.image.data[k])));
    if (gradient.image.data[k] != 0 || k % 97 == 0)
      check(gradient.image.data[k], 1e-2, [k](SmallScene& s) -> float& { return s.image.data[k]; });
  }
  EXPECT_GT(largest, 0.05);
}

TEST(TorchScript, OnlyTheGivenProposalsPullOnTheInputs) {
  const auto detector = load("works");
  const SmallScene scene;
  auto found = detector->forward(scene.view(), -1, false);
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.logit > b.logit; });
  const double between = (found[0].score() + found[1].score()) / 2;
  detector->forward(scene.view(), -1, true);
  std::vector<double> d_all(3, 0);
  const auto all = detector->forward(scene.view(), -1, true);
  for (std::size_t i = 0; i < 3; ++i) d_all[i] = all[i].logit == found[0].logit;
  const SensorGradient whole = detector->backward(d_all);
  ASSERT_EQ(detector->forward(scene.view(), between, true).size(), 1u);
  const SensorGradient one = detector->backward(std::vector<double>{1});
  EXPECT_EQ(whole.points, one.points);
  EXPECT_EQ(whole.image.data, one.image.data);
}

TEST(TorchScript, NothingFoundAndNothingSeen) {
  const auto none = load("empty");
  const SmallScene scene;
  EXPECT_TRUE(none->forward(scene.view(), 0, true).empty());
  const SensorGradient zero = none->backward({});
  for (const float value : zero.image.data) ASSERT_EQ(value, 0);
  const auto detector = load("works");
  SmallScene blank;
  blank.points.clear();
  EXPECT_EQ(detector->forward(blank.view(), -1, true).size(), 3u);
  EXPECT_TRUE(detector->backward(std::vector<double>(3, 1)).points.empty());
}

TEST(TorchScript, OneArgumentIsADetectorInThePicture) {
  const auto both = load("works");
  EXPECT_FALSE(both->capabilities().matching().in_picture());
  EXPECT_TRUE(both->capabilities().reads_points);
  for (const char* name : {"picture_option", "picture_options"})
    EXPECT_TRUE(load(name)->capabilities().finds_picture) << name;
  const auto detector = load("picture");
  const Capabilities can = detector->capabilities();
  EXPECT_TRUE(can.matching().in_picture());
  EXPECT_TRUE(can.reads_image);
  EXPECT_FALSE(can.reads_points || can.finds_bev);
  const SmallScene scene;
  const auto found = detector->forward(scene.view(), -1, true);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].picture.left, 2);
  EXPECT_EQ(found[1].picture.bottom, 25);
  EXPECT_EQ(found[1].box.bev.length, 0);
  EXPECT_GT(found[0].logit, found[1].logit);

  const SensorGradient gradient = detector->backward(std::vector<double>{1, -0.5});
  for (const auto& point : gradient.points)
    for (const float d : point) EXPECT_EQ(d, 0);
  double largest = 0;
  for (std::size_t k = 0; k < scene.image.data.size(); k += 7) {
    const auto value = [&](float change) {
      SmallScene other = scene;
      other.image.data[k] += change;
      const auto there = detector->forward(other.view(), -1, false);
      return there[0].logit - 0.5 * there[1].logit;
    };
    EXPECT_NEAR(gradient.image.data[k], (value(0.1f) - value(-0.1f)) / 0.2, 2e-5);
    largest = std::max(largest, std::abs(static_cast<double>(gradient.image.data[k])));
  }
  EXPECT_GT(largest, 1e-3);
  EXPECT_TRUE(detector->forward({nullptr, scene.points, &scene.calibration}, -1, true).empty());
  detector->backward({});
}

TEST(TorchScript, EveryWrongModelIsToldWhy) {
  EXPECT_THAT(load_error("no_argument"), HasSubstr("forward: takes 0 arguments"));
  EXPECT_THAT(load_error("picture_typed"), HasSubstr("its argument 'image' is of type float"));
  EXPECT_THAT(load_error("picture_columns"),
              HasSubstr("forward's boxes: have shape [2, 5]; return [M,4]: left, top"));
  EXPECT_THAT(load_error("picture_one_tensor"), HasSubstr("return (boxes [M,4], logits [M])"));
  EXPECT_THAT(load_error("picture_detached"), HasSubstr("don't depend on image in a differentiable way"));
  EXPECT_THAT(load_error("no_forward"),
              HasSubstr("forward: the model has no such method; export forward(image"));
  EXPECT_THAT(load_error("two_arguments"), HasSubstr("forward: takes 2 arguments"));
  EXPECT_THAT(load_error("typed"), HasSubstr("its argument 'points' is of type float[]"));
  EXPECT_THAT(load_error("one_tensor"), HasSubstr("forward: returns Tensor where two Tensors belong"));
  EXPECT_THAT(load_error("box_columns"), HasSubstr("forward's boxes: have shape [3, 4]; return [M,5]"));
  EXPECT_THAT(load_error("logit_count"), HasSubstr("forward's logits: have shape [2] for 3 boxes"));
  EXPECT_THAT(load_error("whole_numbers"), HasSubstr("forward's logits: holds Long values"));
  EXPECT_THAT(load_error("not_finite"), HasSubstr("forward's logits: are not finite (row 0)"));
  EXPECT_THAT(load_error("infinite_gradient"), HasSubstr("is not finite"));
  EXPECT_THAT(load_error("detached"), HasSubstr("don't depend on image or points in a differentiable way"));
  EXPECT_THAT(load_error("fails_inside"), HasSubstr("forward: failed ("));
  EXPECT_THAT(load_error("bad_region"), HasSubstr("region: is not [x_min, x_max, y_min, y_max]"));
  write_file(models() / "text.pt", "this is text");
  EXPECT_THAT(load_error("text"), HasSubstr("not a TorchScript model"));
}

TEST(TorchScript, WrongAtASingleFrameIsTheModelsFaultToo) {
  // fine on the scene it is tried on, not finite on this one
  const auto detector = load("works");
  SmallScene scene;
  scene.points[4].z = std::numeric_limits<float>::infinity();
  const auto run = [&] { detector->forward(scene.view(), -1, false); };
  EXPECT_THAT(test::error_text<InputError>(run), HasSubstr("works.pt: forward's logits: are not finite"));
}

TEST(TorchScript, BoxesOfNoSizeAreRefusedWithTheBox) {
  const SmallScene scene;
  const auto refusal = [&](const std::string& model) {
    const auto detector = load(model);
    const std::string text =
        test::error_text<InputError>([&] { detector->forward(scene.view(), -1, false); });
    EXPECT_THAT(text, AllOf(HasSubstr(model + ".pt: box 0 of "), Not(HasSubstr("\n"))));
    return text;
  };
  EXPECT_THAT(refusal("negative_length"), HasSubstr("length -4 m"));
  EXPECT_THAT(refusal("negative_sides"), HasSubstr("positive"));
  EXPECT_THAT(refusal("no_width"), HasSubstr("width 0 m"));
  EXPECT_THAT(refusal("huge"), HasSubstr("at most 1000 m"));
  EXPECT_THAT(refusal("far"), HasSubstr("is not a place near the sensor"));
  EXPECT_THAT(refusal("picture_centres"), HasSubstr("not a centre and a size"));
}

// A weights file is data: one with code that LibTorch would run on loading is refused unread.
TEST(TorchScript, IsCodeAndWeightsAreNot) {
  const auto mark = models() / "mark", file = models() / "planted.pt";
  EXPECT_THROW(load("planted"), InputError);
  EXPECT_TRUE(std::filesystem::remove(mark)) << "loading a model runs what it says";
#ifdef MIRAGE_HAS_FUSION
  for (const char* detector : {"fusion", "lidar", "late"}) {
    DetectorOptions options{detector, file, false, 1, 1};
    EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }),
                AllOf(HasSubstr("planted.pt"), HasSubstr("is for --detector torchscript")));
    EXPECT_FALSE(std::filesystem::exists(mark)) << detector;
  }
#endif
}

TEST(TorchScript, NeedsAModelAndDoesNotTrain) {
  DetectorOptions options;
  options.detector = "torchscript";
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }), HasSubstr("--weights MODEL"));
  options.fresh = true;
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }), HasSubstr("trained in PyTorch"));
  const auto detector = load("works");
  EXPECT_THAT(test::error_text<InputError>([&] { detector->train_step({}, 1); }),
              HasSubstr("trained in PyTorch"));
  EXPECT_THROW(detector->backward(std::vector<double>{1}), Failure);  // no forward before it
}

}  // namespace
}  // namespace mirage

#endif
