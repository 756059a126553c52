// A ceiling before a detector: returns and pixels above it are removed and have no gradient.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "base/error.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/defenses.h"
#include "support/files.h"
#include "support/scripted_detector.h"

namespace mirage {
namespace {

/// The inputs of the detector under the ceiling.
struct Given {
  ImageF image, clean_image;
  std::vector<LidarPoint> points, clean_points, watched;
  std::map<std::string, ImageF> beside;  ///< pictures of cameras beside the first
};

class Witness : public Detector {
 public:
  explicit Witness(Given& given, std::vector<std::string> reads = {})
      : given_(given), reads_(std::move(reads)) {}
  std::string name() const override { return "witness"; }
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads = reads_;
    return can;
  }
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
    for (const SensorData& sensor : sensors(input, capabilities(), name()))
      if (sensor.kind == SensorData::Kind::camera && sensor.name != kFirstCamera)
        given_.beside[sensor.name] = *sensor.image;
    return {{{10, 0, 4, 2, 0}, 0}};
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient;
    gradient.image = ImageF(given_.image.width, given_.image.height, 3, static_cast<float>(d_logits[0]));
    for (const LidarPoint& p : given_.points) gradient.points.push_back({p.x, p.y, p.z, 1});
    for (const LidarPoint& p : given_.watched) gradient.presence.push_back(p.z);
    for (const auto& [name, image] : given_.beside)
      gradient.others[name].assign(image.data.size(), static_cast<float>(d_logits[0]));
    gradient.others["radar"] = {7};
    return gradient;
  }
  TrainingLoss train_step(std::span<const TrainingSample> samples, double) override {
    forward(samples[0].input, 0, false);
    return {};
  }
  void save(const std::filesystem::path&, bool) override {}
  std::unique_ptr<Detector> share() override { return std::make_unique<Witness>(given_, reads_); }

 private:
  Given& given_;
  std::vector<std::string> reads_;
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

/// Error of the road's height in a scene: it is the lowest return within one to two metres, here on a slope.
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
  // The camera stands 5 cm above the ceiling: its horizon is row 30, and 5 cm at 70 m are a twentieth of a
  // pixel.
  for (int v = 0; v < 60; ++v)
    for (int u = 0; u < 124; ++u) EXPECT_EQ(given.image.at(u, v, 1), v < 31 ? 0 : 0.5f) << v;
  // A ceiling of 2.3 m keeps everything below it 70 m ahead: 0.65 m above the camera, 0.67 pixels.
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
  UnchangedInput clean{&scene.image, scene.points, 7, {0, 0, 10, 10}};
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

/// A frame whose second camera, "back", looks backwards from the first one's height.
Frame with_camera_behind(const CeilingScene& scene) {
  Calibration behind = scene.calibration;
  behind.camera_from_velo.linear() << 0, 1, 0, 0, 0, -1, -1, 0, 0;
  Frame frame;
  frame.others.push_back({"back", behind, Lazy<ImageF>([&scene] { return scene.image; })});
  return frame;
}

TEST(Ceiling, HidesAsMuchOfCamerasBesideTheFirst) {
  const CeilingScene scene;
  const Frame frame = with_camera_behind(scene);
  Given given;
  const auto detector =
      under_ceiling(std::make_unique<Witness>(given, std::vector<std::string>{"back"}), kCeiling, kUnit);
  SensorView view = scene.view();
  view.frame = &frame;
  ImageF attacked = scene.image;
  attacked.data[0] = 0.75f;
  for (const bool is_recorded : {true, false}) {
    if (!is_recorded) view.others.push_back(sensor_beside(frame, 0, &attacked));
    detector->forward(view, 0, true);
    const SensorGradient gradient = detector->backward(std::vector<double>{0.25});
    ASSERT_EQ(given.beside.at("back").width, 124);
    ASSERT_EQ(gradient.others.at("back").size(), scene.image.data.size());
    EXPECT_EQ(gradient.others.at("radar"), std::vector<float>{7});
    for (int v = 0; v < 60; ++v) {
      EXPECT_EQ(given.beside["back"].at(10, v, 2), v < 31 ? 0 : 0.5f) << v;
      EXPECT_EQ(gradient.others.at("back")[as_size(3 * (124 * v + 10) + 2)], v < 31 ? 0 : 0.25f) << v;
    }
    EXPECT_EQ(given.beside["back"].data[0], 0);
  }
}

TEST(Jpeg, CompressesCamerasBesideTheFirst) {
  CeilingScene scene;
  RandomStream random(6, "jpeg beside");
  for (float& value : scene.image.data) value = static_cast<float>(random.uniform());
  const Frame frame = with_camera_behind(scene);
  Given given;
  const auto detector = behind_jpeg(std::make_unique<Witness>(given, std::vector<std::string>{"back"}), 40);
  SensorView view = scene.view();
  view.frame = &frame;
  detector->forward(view, 0, true);
  EXPECT_NE(given.image.data, scene.image.data);
  EXPECT_EQ(given.beside.at("back").data, given.image.data);
  EXPECT_EQ(detector->backward(std::vector<double>{0.25}).others.at("back"),
            std::vector<float>(scene.image.data.size(), 0.25f));
}

}  // namespace

// A detector compared with the solid bodies in the sweep.

namespace {

using test::error_text;
using test::Script;
using test::Scripted;

/// A box that stops all rays, or a `share` (at most 1) of them.
struct ShadowBlock {
  Box3 box;
  double share = 1;
};

/// The sweep of 64 beams over a road with a slope of 2 %, with blocks on it.
std::vector<LidarPoint> sweep_of(const std::vector<ShadowBlock>& blocks) {
  RandomStream random(3, "porous");
  std::vector<LidarPoint> points;
  for (int beam = 0; beam < 64; ++beam)
    for (int column = -220; column <= 220; ++column) {
      const double elevation = (2 - beam * 26.8 / 63) * std::numbers::pi / 180,
                   azimuth = column * 0.18 * std::numbers::pi / 180;
      const Vec3d ray(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                      std::sin(elevation));
      double nearest = 90;
      if (ray.z() < 0.02 * ray.x()) nearest = std::min(nearest, -1.7 / (ray.z() - 0.02 * ray.x()));
      for (const ShadowBlock& block : blocks) {
        if (block.share < 1 && random.uniform() > block.share) continue;
        const Transform box_from_velo = velo_from_box(block.box).inverse();
        const Vec3d from = box_from_velo.translation(), way = box_from_velo.linear() * ray;
        const Vec3d low(-block.box.bev.length / 2, -block.box.bev.width / 2, 0),
            high(block.box.bev.length / 2, block.box.bev.width / 2, block.box.height);
        const Vec3d a = (low - from).cwiseQuotient(way), b = (high - from).cwiseQuotient(way);
        const double enters = a.cwiseMin(b).maxCoeff(), leaves = a.cwiseMax(b).minCoeff();
        if (enters > 0 && enters < leaves) nearest = std::min(nearest, enters);
      }
      if (nearest >= 90) continue;
      const Vec3f end = (nearest * ray).cast<float>();
      points.push_back({end.x(), end.y(), end.z(), 0.3f});
    }
  return points;
}

Box3 standing(const BevBox& bev, double height) {
  return {bev, -1.7 + 0.02 * bev.x, height};
}

const BevBox kSide{15, 3, 4.1, 1.7, 0.4}, kRear{22, -3, 4.0, 1.65, 0.02}, kEmpty{12, -2.5, 4, 1.7, 0};

TEST(Bodies, CarsAreFoundWithTheirBoxesAndOtherThingsAreNot) {
  for (const BevBox& car : {kSide, kRear}) {
    const auto points = sweep_of({{standing(car, 1.5)}});
    const auto found = BodyEvidence(points).bodies();
    ASSERT_EQ(found.size(), 1u);
    EXPECT_GT(iou(found[0], car), 0.75);
  }
  EXPECT_EQ(BodyEvidence(sweep_of({{standing(kSide, 1.5)}, {standing(kRear, 1.5)}})).bodies().size(), 2u);
  const auto none = [](const ShadowBlock& block) {
    const auto points = sweep_of({block});
    return BodyEvidence(points).bodies().empty();
  };
  EXPECT_TRUE(none({standing({15, 3, 0.4, 0.4, 0}, 3)}));         // a pole
  EXPECT_TRUE(none({standing({15, 3, 12, 0.5, 0.3}, 2)}));        // a wall
  EXPECT_TRUE(none({standing({15, 3, 4, 1.7, 0.3}, 0.5)}));       // a kerb
  EXPECT_TRUE(none({standing({15, 3, 4, 1.7, 0.3}, 1.5), 0.6}));  // a bush
  EXPECT_TRUE(none({standing({55, 3, 4, 1.7, 1.5}, 1.5)}));       // too far to tell
  EXPECT_TRUE(BodyEvidence({}).bodies().empty());
}

TEST(Bodies, AnObjectOnTheRoofChangesNothing) {
  const ShadowBlock car{standing(kSide, 1.5)};
  Box3 object = standing({15, 3, 0.8, 0.8, 1.0}, 0.7);
  object.bottom += 1.5;
  const auto clean = sweep_of({car}), attacked = sweep_of({car, {object}});
  ASSERT_TRUE(std::any_of(attacked.begin(), attacked.end(), [&](const LidarPoint& p) {
    return contains(object, {p.x, p.y, p.z}, 0.01);
  }));
  const auto before = BodyEvidence(clean).bodies(), after = BodyEvidence(attacked).bodies();
  ASSERT_EQ(before.size(), 1u);
  ASSERT_EQ(after.size(), 1u);
  EXPECT_GT(iou(before[0], after[0]), 0.999);
  const RayCount a = BodyEvidence(clean).rays(kSide), b = BodyEvidence(attacked).rays(kSide);
  EXPECT_EQ(a.stopped, b.stopped);
  EXPECT_EQ(a.passed, b.passed);
}

TEST(Bodies, RaysThatGoThroughAreCounted) {
  const auto points = sweep_of({{standing(kSide, 1.5)}, {standing({30, -2, 0.5, 20, 0}, 2.5)}});
  const BodyEvidence evidence(points);
  const RayCount empty = evidence.rays(kEmpty), car = evidence.rays(kSide);
  EXPECT_GT(empty.passed, 100);
  EXPECT_EQ(empty.stopped, 0);
  EXPECT_GT(car.stopped, 100);
  EXPECT_EQ(car.passed, 0);
  EXPECT_EQ(evidence.rays({40, -2, 4, 1.7, 0}).passed, 0);  // behind a wall there is no evidence
}

TEST(RoadSurface, IsAPlaneWhereTheRoadIsNotSeen) {
  auto points = sweep_of({});
  const RoadSurface seen(points);
  EXPECT_NEAR(seen.height(20, 0), -1.7 + 0.02 * 20, 0.05);
  std::erase_if(points, [](const LidarPoint& p) { return std::abs(p.x - 20) < 3; });
  for (int i = -20; i <= 20; ++i) points.push_back({20, 0.1f * static_cast<float>(i), -0.1f, 0});  // a roof
  EXPECT_NEAR(RoadSurface(points).height(20, 0), -1.7 + 0.02 * 20, 0.05);
  EXPECT_EQ(RoadSurface({}).height(20, 0), -1.7);
}

const Capabilities kBothSensors{true, true, true, false};

struct ShadowStreet {
  Script script;
  ImageF image{4, 4, 3};
  std::vector<LidarPoint> points = sweep_of({{standing(kSide, 1.5)}, {standing({30, -2, 0.5, 20, 0}, 2.5)}});
  std::unique_ptr<Detector> detector() {
    return with_shadows(std::make_unique<Scripted>("fusion", kBothSensors, script));
  }
  std::vector<Detection> answers(double threshold = 0) {
    return detector()->forward({&image, points, nullptr}, threshold, false);
  }
};

TEST(Shadows, ABodyIsFoundThoughTheDetectorDoesNotAndWhatRaysPassIsNoCar) {
  ShadowStreet street;
  BevBox turned = kSide;
  turned.yaw += 0.5;
  street.script.lines = {{{turned, -3}}, {{kEmpty, 5}}, {{{40, -2, 4, 1.7, 0}, 5}}};
  const auto found = street.answers();
  ASSERT_EQ(found.size(), 4u);
  EXPECT_NEAR(found[0].logit, kBodyLogit + kSaturatedSlope * (-3 - kBodyLogit), 1e-12);
  EXPECT_NEAR(found[1].logit, kThroughLogit + kSaturatedSlope * (5 - kThroughLogit), 1e-12);
  EXPECT_EQ(found[2].logit, 5);  // without evidence it is unchanged
  EXPECT_GT(found[3].logit, found[0].logit);
  EXPECT_GT(iou(found[3].box.bev, kSide), 0.75);  // the body's own box comes first
  // A detected car needs no body; a body without a detection is no car.
  street.script.lines = {{{kSide, 2}}};
  ASSERT_EQ(street.answers().size(), 1u);
  EXPECT_EQ(street.answers()[0].logit, 2);
  street.script.lines = {};
  EXPECT_TRUE(street.answers().empty());
  street.script.lines = {{{kSide, -7.5}}};
  for (const Detection& proposal : street.answers()) EXPECT_LT(proposal.score(), 0.05);
  EXPECT_TRUE(street.answers(0.3).empty());
}

TEST(Shadows, AnswersRiseWithWhatTheDetectorSaysWithoutSteps) {
  ShadowStreet street;
  for (const BevBox& place : {kSide, kEmpty}) {
    double before = -1e9;
    for (int step = 0; step < 1090; ++step) {
      const double logit = -7.9 + 0.01 * step;
      street.script.lines = {{{place, logit}}};
      const auto found = street.answers();
      ASSERT_FALSE(found.empty());
      EXPECT_GT(found[0].logit, before);
      EXPECT_LT(found[0].logit - before, before < -1e8 ? 1e10 : 0.011);
      before = found[0].logit;
    }
  }
}

TEST(Shadows, TheGradientIsThatOfDifferences) {
  ShadowStreet street;
  BevBox turned = kSide;
  turned.yaw += 0.5;
  street.image.data[0] = 0.5f;
  street.script.lines = {
      {{turned, -2}, 1.5}, {{turned, -6}, 0.7}, {{kEmpty, 4}, -0.6}, {{kEmpty, -3.5}, 2.0}};
  const auto detector = street.detector();
  const auto sum = [&](double pixel) {
    street.image.data[0] = static_cast<float>(pixel);
    double all = 0;
    const auto found = detector->forward({&street.image, street.points, nullptr}, 0, true);
    for (std::size_t k = 0; k < found.size(); ++k) all += (1 + 0.3 * static_cast<double>(k)) * found[k].logit;
    return std::pair(all, found.size());
  };
  const std::size_t count = sum(0.5).second;
  EXPECT_EQ(count, 5u);
  std::vector<double> weights;
  for (std::size_t k = 0; k < count; ++k) weights.push_back(1 + 0.3 * static_cast<double>(k));
  const double exact = detector->backward(weights).image.data[0];
  EXPECT_NEAR(exact, (sum(0.625).first - sum(0.375).first) / 0.25, 1e-5);  // exact in binary
}

TEST(Shadows, NeedReturnsAndBoxesFromAbove) {
  Script script;
  const Capabilities camera{true, false, false, true};
  EXPECT_THAT(
      error_text<FieldError>([&] { with_shadows(std::make_unique<Scripted>("camera", camera, script)); }),
      testing::StartsWith("defense: shadows: camera finds no boxes from above"));
}

}  // namespace
}  // namespace mirage
