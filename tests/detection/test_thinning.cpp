// JPEG before a detector: compresses forward, and passes gradients straight through.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "detection/defenses.h"
#include "detection/training.h"
#include "geometry/mesh.h"
#include "scene/occlusion.h"
#include "support/files.h"

namespace mirage {
namespace {

/// Its one logit is the picture's sum; it stores the picture.
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

// Training samples that lose beams, or returns of cars.

namespace {

const BevBox kThinnedCar{12, 2, 4, 1.8, 0.3}, kOther{20, -4, 4, 1.8, 0};

/// A car and a look-alike on level ground, in kitti64's returns.
CompactFrame sample(const LidarModel& lidar) {
  std::vector<Mesh> meshes(1);
  append(meshes[0], box_mesh({300, 300, 2}), Transform(Eigen::Translation3d(0, 0, -2.73)));
  for (const BevBox& box : {kThinnedCar, kOther}) {
    meshes.emplace_back();
    append(meshes.back(), box_mesh({box.length, box.width, 1.5}),
           velo_from_box({box, -1.73, 1.5}) * Eigen::Translation3d(0, 0, 0.75));
  }
  const RayCaster caster(meshes);
  CompactFrame frame;
  for (std::size_t b = 0; b < lidar.beams.size(); ++b)
    for (int column = 0; column < lidar.azimuth_count(); ++column) {
      const LidarRay fired = lidar.ray(static_cast<int>(b), column);
      if (fired.direction.x() < 0.7) continue;
      const Hit hit =
          caster.intersect({fired.origin.cast<float>(), fired.direction.cast<float>(), 0.5f, 100.f});
      if (!hit.hit()) continue;
      const Vec3f p = (fired.origin + hit.t * fired.direction).cast<float>();
      frame.points.push_back({p.x(), p.y(), p.z(), 0.3f});
    }
  frame.truth.space.boxes = {kThinnedCar};
  frame.truth.space.look_alikes = {kOther};
  return frame;
}

/// Returns on the thing itself: 0.2 m above the road and higher.
std::size_t on(const BevBox& box, const CompactFrame& frame) {
  std::size_t count = 0;
  for (const LidarPoint& p : frame.points) {
    const Vec3d at = p.position().cast<double>();
    count += p.z > -1.53f && contains({box, -2, 3}, at, 0.1);
  }
  return count;
}

TEST(LidarThinning, TakesBeamsOrReturnsOfCarsInItsShareOfTheSamples) {
  const LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  const CompactFrame whole = sample(lidar);
  const std::size_t of_car = on(kThinnedCar, whole), of_other = on(kOther, whole), all = whole.points.size();
  ASSERT_GT(of_car, 200u);
  ASSERT_GT(of_other, 100u);
  ASSERT_EQ(beams_of(whole.points, lidar).size(), all);
  constexpr int samples = 400;
  int untouched = 0, by_beam[9] = {}, by_object = 0, car_lost = 0, other_lost = 0;
  for (std::uint64_t index = 0; index < samples; ++index) {
    CompactFrame frame = whole;
    thin_lidar(frame, lidar, 0.5, 3, index);
    CompactFrame again = whole;
    thin_lidar(again, lidar, 0.5, 3, index);
    ASSERT_EQ(frame.points.size(), again.points.size());
    EXPECT_EQ(frame.truth.space.boxes.size(), 1u);
    const std::size_t ground = frame.points.size() - on(kThinnedCar, frame) - on(kOther, frame);
    if (ground == all - of_car - of_other) {  // the road stays: nothing, or objects only
      const auto judge = [&](std::size_t left, std::size_t before, int& lost) {
        if (left == before) return;
        EXPECT_LT(static_cast<double>(left), 0.42 * static_cast<double>(before));
        ++lost;
      };
      const int before = car_lost + other_lost;
      judge(on(kThinnedCar, frame), of_car, car_lost);
      judge(on(kOther, frame), of_other, other_lost);
      (car_lost + other_lost > before ? by_object : untouched) += 1;
      continue;
    }
    std::set<int> beams;
    for (int b : beams_of(frame.points, lidar)) beams.insert(b);
    ASSERT_GE(beams.size(), 2u);
    const int step = *std::next(beams.begin()) - *beams.begin();
    ASSERT_TRUE(step == 2 || step == 4 || step == 8) << step;
    for (int b : beams) EXPECT_EQ(b % step, *beams.begin() % step);
    ++by_beam[step];
  }
  EXPECT_NEAR(by_beam[2] + by_beam[4] + by_beam[8], samples / 4, 35);
  for (int step : {2, 4, 8}) EXPECT_GT(by_beam[step], 15) << step;
  // Half of the samples as they are, and those of the rest in which neither was drawn (0.7²).
  EXPECT_NEAR(untouched, samples * (0.5 + 0.25 * 0.49), 40);
  EXPECT_NEAR(by_object, samples * 0.25 * 0.51, 25);
  EXPECT_GT(car_lost, 10);
  EXPECT_GT(other_lost, 10);  // or a gap would mean a car
  CompactFrame frame = whole;
  thin_lidar(frame, lidar, 0, 3, 1);
  EXPECT_EQ(frame.points.size(), all);
}

}  // namespace
}  // namespace mirage
