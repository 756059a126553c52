// Networks as ONNX files: values of valid models, and one clear line for each error. Skipped without ONNX
// Runtime.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <thread>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "detection/detector.h"
#include "support/files.h"

#ifdef MIRAGE_HAS_ONNX

namespace mirage {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// Runs a Python program of the sources, with Debian's Python.
void run_python(const std::string& words) {
  ASSERT_EQ(std::system(("/usr/bin/python3 -B " MIRAGE_SOURCE "/" + words).c_str()), 0) << words;
}

const std::filesystem::path& onnx_models() {
  static const test::TemporaryFolder folder;
  static const bool written = [] {
    run_python("tests/detection/plugins/onnx_models.py " + folder.path().string());
    return true;
  }();
  EXPECT_TRUE(written);
  return folder.path();
}

std::unique_ptr<Detector> load_model(const std::string& detector, const std::filesystem::path& file) {
  DetectorOptions options;
  options.detector = detector;
  options.weights = file;
  options.threads = 1;
  return load_detector(options);
}

std::unique_ptr<Detector> load_onnx(const std::string& model) {
  return load_model("onnx", onnx_models() / (model + ".onnx"));
}

struct Street {
  ImageF image{60, 30, 3};
  std::vector<LidarPoint> points;
  Calibration calibration;
  Street() {
    RandomStream random(3, "onnx street");
    for (float& value : image.data) value = static_cast<float>(random.uniform());
    for (int i = 0; i < 200; ++i)
      points.push_back({static_cast<float>(random.uniform(8, 30)), static_cast<float>(random.uniform(-5, 5)),
                        static_cast<float>(random.uniform(-1.5, 0.5)), static_cast<float>(random.uniform())});
    calibration.camera = {60, 60, 30, 10, 60, 30};
    calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    calibration.camera_from_velo.translation().z() = 0.25;
  }
  SensorView view() const { return {&image, points, &calibration}; }
};

double mean(std::span<const float> values) {
  double sum = 0;
  for (const float value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

TEST(Onnx, RunsAModelAndReadsItsRegion) {
  const auto detector = load_onnx("works");
  EXPECT_EQ(detector->name(), "onnx");
  EXPECT_EQ(detector->region(), (std::array<double, 4>{0, 50, -20, 20}));
  const Capabilities can = detector->capabilities();
  EXPECT_TRUE(can.reads_image && can.reads_points && can.finds_bev);
  EXPECT_FALSE(can.finds_picture || can.has_gradients);
  const Street street;
  const auto found = detector->forward(street.view(), -1, false);
  ASSERT_EQ(found.size(), 3u);
  EXPECT_FLOAT_EQ(static_cast<float>(found[1].box.bev.yaw), 0.3f);
  EXPECT_EQ(found[2].box.bev.x, 20);
  // The model's logits: its picture, its points and the depth of the camera's origin, weighted 1, -0.5, 2.
  const double sum = mean(street.image.data) + mean({&street.points[0].x, 4 * street.points.size()}) + 0.25;
  EXPECT_NEAR(found[0].logit, sum, 1e-5);
  EXPECT_NEAR(found[1].logit, -0.5 * sum, 1e-5);
  EXPECT_EQ(detector->forward(street.view(), found[0].score() - 1e-6, false).size(), 2u);
  EXPECT_THROW(detector->backward(std::vector<double>(3, 1)), Failure);
}

TEST(Onnx, ReadsThePictureOrTheSweepAlone) {
  const auto picture = load_onnx("picture"), sweep = load_onnx("sweep");
  EXPECT_TRUE(picture->capabilities().matching().in_picture());
  EXPECT_FALSE(picture->capabilities().reads_points);
  EXPECT_FALSE(sweep->capabilities().reads_image);
  EXPECT_EQ(sweep->region(), (std::array<double, 4>{0, 70, -40, 40}));
  const Street street;
  const auto found = picture->forward(street.view(), -1, false);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[1].picture.bottom, 25);
  EXPECT_NEAR(found[1].logit, -0.5 * mean(street.image.data), 1e-5);
  EXPECT_TRUE(picture->forward({nullptr, street.points, &street.calibration}, -1, false).empty());
  EXPECT_EQ(sweep->forward({nullptr, street.points, &street.calibration}, -1, false).size(), 3u);
}

TEST(Onnx, SharesAFileAmongThreads) {
  const auto detector = load_onnx("works");
  const Street street;
  const double alone = detector->forward(street.view(), -1, false)[0].logit;
  std::vector<std::thread> threads;
  std::vector<double> together(4);
  for (double& logit : together)
    threads.emplace_back([&, mine = detector->share()] {
      for (int k = 0; k < 20; ++k) logit = mine->forward(street.view(), -1, false)[0].logit;
    });
  for (std::thread& thread : threads) thread.join();
  for (const double logit : together) EXPECT_EQ(logit, alone);
}

TEST(Onnx, EveryWrongModelIsToldWhy) {
  const auto message_of = [](const std::string& model) {
    const std::string text = test::error_text<InputError>([&] { load_onnx(model); });
    EXPECT_THAT(text, AllOf(Not(HasSubstr("\n")), HasSubstr(model + ".onnx: ")));
    return text;
  };
  EXPECT_THAT(message_of("channels_first"),
              HasSubstr("input image: has shape [1,3,-1,-1]; name the inputs image [H,W,3]"));
  EXPECT_THAT(message_of("other_input"), HasSubstr("input data: is not known"));
  EXPECT_THAT(message_of("double"), HasSubstr("input points: is not of float32"));
  EXPECT_THAT(message_of("no_boxes"), HasSubstr("there is none named boxes; name the outputs"));
  EXPECT_THAT(message_of("columns"), HasSubstr("boxes: have shape [1,7]"));
  EXPECT_THAT(message_of("count"), HasSubstr("logits: have shape [2] for 3 boxes"));
  EXPECT_THAT(message_of("whole_numbers"), HasSubstr("logits: are not of float32"));
  EXPECT_THAT(message_of("not_finite"), HasSubstr("logits: are not finite (value 0)"));
  EXPECT_THAT(message_of("bad_region"),
              HasSubstr("metadata region: \"0 50 20\" is not x_min x_max y_min y_max"));
  write_file(onnx_models() / "text.onnx", "this is text");
  EXPECT_THAT(message_of("text"), HasSubstr("file: is not an ONNX model ("));
}

TEST(Onnx, OfAnotherPicturesSizeIsRefusedAtTheFrame) {
  const auto detector = load_onnx("of_a_size");
  const Street street;
  EXPECT_THAT(test::error_text<InputError>([&] { detector->forward(street.view(), -1, false); }),
              AllOf(HasSubstr("of_a_size.onnx: the model: failed ("), HasSubstr("dynamic_axes"),
                    Not(HasSubstr("\n"))));
}

TEST(Onnx, NeedsAModelAndDoesNotTrain) {
  DetectorOptions options;
  options.detector = "onnx";
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }), HasSubstr("--weights"));
  EXPECT_THAT(test::error_text<InputError>([&] { load_onnx("works")->train_step({}, 1); }),
              HasSubstr("is not trained here"));
}

// One network in both formats: PyTorch's exports mean the same to both plugins.
TEST(Onnx, AnswersAsTheSameNetworkInTorchScript) {
  const test::TemporaryFolder folder;
  const auto exported = [&](const char* name) {
    const auto file = folder / name;
    run_python("plugins/detectors/torchscript/example_export.py " + file.string());
    return file;
  };
  const auto onnx = load_model("onnx", exported("example.onnx"));
  const auto torch = load_model("torchscript", exported("example.pt"));
  EXPECT_EQ(onnx->region(), torch->region());
  const Street street;
  const auto first = onnx->forward(street.view(), 0, false), second = torch->forward(street.view(), 0, false);
  ASSERT_GT(first.size(), 100u);
  ASSERT_EQ(first.size(), second.size());
  double most = -10, least = 10;
  for (std::size_t i = 0; i < first.size(); ++i) {
    ASSERT_NEAR(first[i].logit, second[i].logit, 1e-4);
    ASSERT_NEAR(first[i].box.bev.x, second[i].box.bev.x, 1e-4);
    ASSERT_NEAR(first[i].box.bev.yaw, second[i].box.bev.yaw, 1e-4);
    most = std::max(most, first[i].logit), least = std::min(least, first[i].logit);
  }
  EXPECT_GT(most - least, 0.1);  // the answers are not all alike
}

}  // namespace
}  // namespace mirage

#endif
