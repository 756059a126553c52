// A ceiling before a detector: what stands above it is not seen, and has no gradient.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/random.h"
#include "detection/ceiling_detector.h"
#include "support/files.h"

namespace mirage {
namespace {

/// What the detector under the ceiling was given.
struct Given {
  ImageF image, clean_image;
  std::vector<LidarPoint> points, clean_points, watched;
};

class Witness : public Detector {
 public:
  explicit Witness(Given& given) : given_(given) {}
  std::string name() const override { return "witness"; }
  std::array<double, 4> region() const override { return {0, 70, -40, 40}; }
  std::vector<Detection> forward(const SensorView& input, double, bool) override {
    given_ = {};
    if (input.image) given_.image = *input.image;
    given_.points.assign(input.points.begin(), input.points.end());
    given_.watched.assign(input.watched.begin(), input.watched.end());
    if (input.clean) {
      given_.clean_image = *input.clean->image;
      given_.clean_points.assign(input.clean->points.begin(), input.clean->points.end());
    }
    return {{{10, 0, 4, 2, 0}, 0}};
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient;
    gradient.image = ImageF(given_.image.width, given_.image.height, 3, static_cast<float>(d_logits[0]));
    for (const LidarPoint& p : given_.points) gradient.points.push_back({p.x, p.y, p.z, 1});
    for (const LidarPoint& p : given_.watched) gradient.presence.push_back(p.z);
    return gradient;
  }
  TrainingLoss train_step(std::span<const TrainingSample> samples, double) override {
    forward(samples[0].input, 0, false);
    return {};
  }
  void save(const std::filesystem::path&, bool) override {}
  std::unique_ptr<Detector> share() override { return std::make_unique<Witness>(given_); }

 private:
  Given& given_;
};

constexpr float kUnit = 1.73f;
constexpr double kCeiling = 1.6;

/// A road that rises by 3 cm a metre, things on it up to 4 m, and a camera 1.65 m over it.
struct CeilingScene {
  ImageF image{124, 60, 3, 0.5f};
  std::vector<LidarPoint> points;
  Calibration calibration;
  static float road(float x) { return -kUnit + 0.03f * x; }
  static bool is_above(const LidarPoint& p) { return p.z > road(p.x) + kCeiling; }

  CeilingScene() {
    calibration.camera = {72, 72, 62, 30, 124, 60};
    calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    calibration.camera_from_velo.translation() = Vec3d(0, -0.08, -0.27);
    RandomStream random(5, "ceiling");
    for (int i = 0; i < 40000; ++i) {
      const auto x = static_cast<float>(random.uniform(1, 60)),
                 y = static_cast<float>(random.uniform(-30, 30));
      const bool stands = i % 20 == 0;
      points.push_back({x, y, road(x) + (stands ? static_cast<float>(random.uniform(0.2, 4)) : 0), 0.2f});
    }
  }
  SensorView view() const { return {&image, points, &calibration}; }
};

/// Of the road's height in a scene: it is the lowest return within one to two metres, here on a slope.
constexpr float kRoadError = 0.08f;

TEST(Ceiling, LeavesOutWhatStandsHigherOverTheRoad) {
  const CeilingScene scene;
  Given given;
  const auto detector = under_ceiling(std::make_unique<Witness>(given), kCeiling, kUnit);
  detector->forward(scene.view(), 0, false);
  std::size_t surely_below = 0, perhaps_below = 0;
  for (const LidarPoint& p : scene.points) {
    surely_below += p.z < CeilingScene::road(p.x) + kCeiling - kRoadError;
    perhaps_below += p.z < CeilingScene::road(p.x) + kCeiling + kRoadError;
  }
  EXPECT_GE(given.points.size(), surely_below);
  EXPECT_LE(given.points.size(), perhaps_below);
  EXPECT_LT(perhaps_below, scene.points.size() - 1000);
  for (const LidarPoint& p : given.points) EXPECT_LT(p.z, CeilingScene::road(p.x) + kCeiling + kRoadError);
}

TEST(Ceiling, HidesPixelsThatSeeNothingBelowIt) {
  const CeilingScene scene;
  Given given;
  const auto detector = under_ceiling(std::make_unique<Witness>(given), kCeiling, kUnit);
  detector->forward(scene.view(), 0, false);
  // The camera stands 5 cm over the ceiling: its horizon is row 30, and 5 cm at 70 m are a twentieth of a
  // pixel.
  for (int v = 0; v < 60; ++v)
    for (int u = 0; u < 124; ++u) EXPECT_EQ(given.image.at(u, v, 1), v < 31 ? 0 : 0.5f) << v;
  // Under one of 2.3 m all is seen that lies below it 70 m ahead: 0.65 m over the camera, 0.67 pixels.
  const auto higher = under_ceiling(std::make_unique<Witness>(given), 2.3, kUnit);
  higher->forward(scene.view(), 0, false);
  for (int v = 0; v < 60; ++v) EXPECT_EQ(given.image.at(62, v, 1), v < 30 ? 0 : 0.5f) << v;
}

TEST(Ceiling, GradientsGoToWhatIsSeen) {
  CeilingScene scene;
  Given given;
  const auto detector = under_ceiling(std::make_unique<Witness>(given), kCeiling, kUnit);
  const std::vector<LidarPoint> watched = {{20, 0, -1, 0}, {20, 0, 2, 0}, {30, 1, -0.5f, 0}};
  SensorView view = scene.view();
  view.watched = watched;
  detector->forward(view, 0, true);
  const SensorGradient gradient = detector->backward(std::vector<double>{0.25});
  ASSERT_EQ(gradient.points.size(), scene.points.size());
  std::size_t seen = 0;
  for (std::size_t i = 0; i < gradient.points.size(); ++i) {
    const LidarPoint& p = scene.points[i];
    if (gradient.points[i][3] == 0) {
      EXPECT_EQ(gradient.points[i], (std::array<float, 4>{}));
      continue;
    }
    EXPECT_EQ(gradient.points[i], (std::array<float, 4>{p.x, p.y, p.z, 1}));  // its own
    ++seen;
  }
  EXPECT_EQ(seen, given.points.size());
  EXPECT_EQ(gradient.presence, (std::vector<float>{-1, 0, -0.5f}));
  for (int v = 0; v < 60; ++v) EXPECT_EQ(gradient.image.at(10, v, 2), v < 31 ? 0 : 0.25f) << v;
}

TEST(Ceiling, TheCleanFrameAndTrainingAreSeenAlike) {
  const CeilingScene scene;
  Given given;
  const auto detector = under_ceiling(std::make_unique<Witness>(given), kCeiling, kUnit);
  CleanView clean{&scene.image, scene.points, 7, {0, 0, 10, 10}};
  SensorView view = scene.view();
  view.clean = &clean;
  detector->share()->forward(view, 0, false);
  EXPECT_EQ(given.clean_image.data, given.image.data);
  ASSERT_EQ(given.clean_points.size(), given.points.size());
  const std::size_t below = given.points.size();
  TrainingSample sample;
  sample.input = scene.view();
  detector->train_step({&sample, 1}, 1e-3);
  EXPECT_EQ(given.points.size(), below);
  EXPECT_EQ(given.image.at(62, 0, 0), 0);
  detector->forward({nullptr, {}, nullptr}, 0, false);
  EXPECT_TRUE(given.image.empty());
  EXPECT_TRUE(given.points.empty());
}

}  // namespace
}  // namespace mirage
