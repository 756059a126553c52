// JPEG before a detector: compresses forward, passes gradients straight through.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "detection/jpeg_detector.h"
#include "support/files.h"

namespace mirage {
namespace {

/// Its one logit is the picture's sum; it remembers the picture.
class SumDetector : public Detector {
 public:
  explicit SumDetector(ImageF& seen) : seen_(seen) {}
  std::string name() const override { return "sum"; }
  std::array<double, 4> region() const override { return {0, 50, -25, 25}; }
  Capabilities capabilities() const override { return {true, false, false, true}; }
  std::vector<Detection> forward(const SensorView& input, double, bool) override {
    seen_ = input.image ? *input.image : ImageF();
    double sum = 0;
    for (float value : seen_.data) sum += value;
    return {{{10, 0, 4, 2, 0}, sum}};
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    return {ImageF(seen_.width, seen_.height, 3, static_cast<float>(d_logits[0])), {}};
  }
  TrainingLoss train_step(std::span<const TrainingSample> samples, double) override {
    seen_ = *samples[0].input.image;
    return {};
  }
  void save(const std::filesystem::path&, bool) override {}
  std::unique_ptr<Detector> share() override { return std::make_unique<SumDetector>(seen_); }

 private:
  ImageF& seen_;
};

ImageF noise(int width, int height) {
  ImageF image(width, height, 3);
  RandomStream random(1, "jpeg test");
  for (float& value : image.data) value = static_cast<float>(random.uniform());
  return image;
}

double difference(const ImageF& a, const ImageF& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += std::abs(double(a.data[i]) - b.data[i]);
  return sum / static_cast<double>(a.data.size());
}

TEST(Jpeg, LosesMoreAtLowerQualityAndLittleOfSmoothPictures) {
  const ImageF image = noise(37, 21);  // no multiple of a block
  const double at90 = difference(image, jpeg_round_trip(image, 90)),
               at10 = difference(image, jpeg_round_trip(image, 10));
  EXPECT_GT(at10, at90);
  EXPECT_GT(at90, 0.001);
  const ImageF grey(64, 32, 3, 0.3f);
  EXPECT_LT(difference(grey, jpeg_round_trip(grey, 75)), 0.004);  // a level of 8 bits
  const ImageF one(1, 1, 3, 1.f);
  EXPECT_LT(difference(one, jpeg_round_trip(one, 75)), 0.01);
}

TEST(Jpeg, StandsBeforeEveryUseOfThePicture) {
  ImageF seen;
  const auto detector = behind_jpeg(std::make_unique<SumDetector>(seen), 50);
  const ImageF image = noise(32, 16), compressed = jpeg_round_trip(image, 50);
  const Calibration calibration;
  const SensorView view{&image, {}, &calibration};
  EXPECT_FALSE(detector->capabilities().finds_bev);
  EXPECT_TRUE(detector->capabilities().finds_picture);
  detector->forward(view, 0, true);
  EXPECT_EQ(seen.data, compressed.data);
  const std::vector<double> one = {0.5};
  for (float d : detector->backward(one).image.data) EXPECT_EQ(d, 0.5f);
  seen = ImageF();
  TrainingSample sample;
  sample.input = view;
  detector->train_step({&sample, 1}, 1e-3);
  EXPECT_EQ(seen.data, compressed.data);
  seen = ImageF();
  detector->share()->forward(view, 0, false);
  EXPECT_EQ(seen.data, compressed.data);
  detector->forward({nullptr, {}, &calibration}, 0, false);  // without a picture there is nothing to compress
  EXPECT_TRUE(seen.data.empty());
}

TEST(Jpeg, ADefenceThatIsNoneIsOneLine) {
  DetectorOptions options;
  options.detector = std::string(MIRAGE_BUILD) + "/test_plugins/fake_works.so";
  options.fresh = true;
  for (const char* wrong : {"jpeg:", "jpeg:0", "jpeg:101", "jpeg:5x", "jpeg:-3"}) {
    options.defense = wrong;
    EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }),
                ::testing::HasSubstr("use jpeg:1 to jpeg:100"))
        << wrong;
  }
  options.fresh = false;
  options.defense = "Stone Wall";
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }),
              ::testing::StartsWith("defense: Stone Wall: "));
  options.defense = "stone-wall";
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }),
              ::testing::HasSubstr("with the defence stone-wall"));
  options.weights = "some.weights";
  EXPECT_THAT(test::error_text<InputError>([&] { load_detector(options); }),
              ::testing::HasSubstr("give one of the two"));
}

}  // namespace
}  // namespace mirage
