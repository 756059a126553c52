// Sensors beside cameras and LiDAR: the shipped example, a radar. Covers the path from an object through it
// to a detector that reads it by name, and the gradient back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "attack/attack_step.h"
#include "attack/observation.h"
#include "base/plugins.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/detector.h"
#include "frames/frame_store.h"
#include "scene/data/kitti.h"
#include "simulation/sensor_abi.h"
#include "simulation/sensor_plugin.h"
#include "support/files.h"
#include "support/gradient_check.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

/// The radar behind its C table.
class Sensors : public testing::Test {
 protected:
  void SetUp() override {
    const ShippedPlugin* radar = shipped_plugin("sensor", "radar");
    if (!radar) GTEST_SKIP() << "plugins are not built";
    api_ = open_plugin<MirageSensorApi>(radar->file, "mirage_sensor_api", "", {MIRAGE_SENSOR_ABI});
    sensor_ = api_->create("{}", nullptr, 0);
    const MirageSensorWord* word = api_->word(sensor_);
    for (std::size_t i = 0; i < 3; ++i) shape_[i] = as_size(word->shape[i]);
  }
  void TearDown() override {
    if (api_) api_->destroy(sensor_);
  }

  std::size_t values() const { return shape_[0] * shape_[1] * shape_[2]; }

  std::vector<double> measure(const MirageSensorScene& scene, const Mesh* object = nullptr,
                              const Vec3d& velocity = Vec3d::Zero(), const double* recorded = nullptr,
                              void** tape = nullptr) {
    std::vector<double> data(values());
    MirageSensorObject raw{};
    std::vector<double> vertices;
    std::vector<std::int32_t> faces;
    if (object) {
      vertices = test::flat(object->vertices);
      for (const Face& face : object->faces)
        for (const auto vertex : face) faces.push_back(static_cast<std::int32_t>(vertex));
      raw.vertices = vertices.data(), raw.vertex_count = static_cast<std::int64_t>(object->vertices.size());
      raw.faces = faces.data(), raw.face_count = static_cast<std::int64_t>(object->faces.size());
      std::copy(velocity.data(), velocity.data() + 3, raw.velocity);
    }
    void* left = nullptr;
    char error[256] = "";
    EXPECT_EQ(api_->measure(sensor_, &scene, object ? &raw : nullptr, recorded, data.data(), &left, error,
                            sizeof error),
              0)
        << error;
    if (tape)
      *tape = left;
    else if (left)
      api_->release(left);
    return data;
  }

  /// The strongest bin: range, azimuth, Doppler.
  std::array<std::size_t, 3> peak(const std::vector<double>& data) const {
    const auto at = as_size(std::max_element(data.begin(), data.end()) - data.begin());
    return {at / (shape_[1] * shape_[2]), at / shape_[2] % shape_[1], at % shape_[2]};
  }

  const MirageSensorApi* api_ = nullptr;
  void* sensor_ = nullptr;
  std::array<std::size_t, 3> shape_ = {};
};

/// One random weight per value.
std::vector<double> weights_of(std::size_t count, std::uint64_t seed) {
  RandomStream random(seed, "weights of a measurement");
  std::vector<double> weights(count);
  for (double& weight : weights) weight = random.uniform(-1, 1);
  return weights;
}

/// Returns on a car, and its speed along x.
struct Echoes {
  Echoes(double range, double azimuth, double speed) {
    const auto x = static_cast<float>(2 + range * std::cos(azimuth)),
               y = static_cast<float>(range * std::sin(azimuth));
    points = {x, y, -1.2f, 1.0f};
    body = {x, y, -1.2, 4, 2, 2, 0, {speed, 0, 0}};
    scene = {"", "", points.data(), 1, &body, 1};
  }
  std::array<float, 4> points{};
  MirageBody body{};
  MirageSensorScene scene{};
};

TEST_F(Sensors, TheRadarPutsAnEchoAtItsRangeAzimuthAndSpeed) {
  const Echoes standing(20, 0.3, 0);
  const auto still = peak(measure(standing.scene));
  EXPECT_EQ(still[0], 15u);  // 1.25 m a bin
  EXPECT_EQ(still[1], 30u);  // 2.5 degrees a bin from −60
  const auto going = peak(measure(Echoes(20, 0, 9).scene)), coming = peak(measure(Echoes(20, 0, -9).scene));
  EXPECT_EQ(going[2], 6u);  // 4 m/s a bin from −16
  EXPECT_EQ(coming[2], 1u);
  // The power falls with the fourth power of the range; the logarithm's noise floor is taken out.
  const auto power = [&](double range) {
    double sum = 0;
    for (const double value : measure(Echoes(range, 0, 0).scene)) sum += std::expm1(value);
    return sum;
  };
  EXPECT_NEAR(power(20) / power(40), 16, 0.2);
}

TEST_F(Sensors, TheRadarsVjpIsTheSlopeOfItsMeasurement) {
  const Echoes car(14, 0.1, 3);
  const std::vector<double> recorded = measure(car.scene);
  RandomStream random(11, "radar object");
  int checked = 0;
  for (const double azimuth : {0.1, 1.04}) {  // amid the field, and across its edge
    Mesh mesh = icosphere(1);
    test::crumple(mesh, random);
    for (Vec3d& v : mesh.vertices)
      v = 0.5 * v + Vec3d(2 + 12 * std::cos(azimuth), 12 * std::sin(azimuth), 0.4);
    // Degenerate: a sliver, and a face whose plane almost contains the radar.
    const auto first = static_cast<int>(mesh.vertices.size());
    for (const Vec3d& v : {Vec3d(12, 0, 0), Vec3d(12, 1e-3, 0), Vec3d(12, 1, 1e-3), Vec3d(14, 1e-3, -1.19)})
      mesh.vertices.push_back(v);
    mesh.faces.push_back({first, first + 1, first + 2});
    mesh.faces.push_back({first, first + 3, first + 2});
    const Vec3d velocity(5, -2, 0);
    const std::vector<double> weights = weights_of(values(), 5);
    const auto loss = [&](const std::vector<double>& x) {
      Mesh moved = mesh;
      for (std::size_t i = 0; i < moved.vertices.size(); ++i)
        moved.vertices[i] = Vec3d::Map(x.data() + 3 * i);
      const std::vector<double> data = measure(car.scene, &moved, velocity, recorded.data());
      return std::inner_product(data.begin(), data.end(), weights.begin(), 0.0);
    };
    void* tape = nullptr;
    measure(car.scene, &mesh, velocity, recorded.data(), &tape);
    std::vector<double> gradient(3 * mesh.vertices.size());
    ASSERT_EQ(api_->vjp(sensor_, tape, weights.data(), gradient.data(), nullptr, nullptr, 0), 0);
    api_->release(tape);
    double length = 0;
    for (const double d : gradient) length += std::abs(d);
    EXPECT_GT(length, 1);
    checked += test::check_gradient(loss, test::flat(mesh.vertices), gradient, 1e-6, 1e-4, 1e-2).checked;
  }
  EXPECT_GT(checked, 200);
}

/// A world with the radar and a moving car.
test::World with_radar() {
  test::World world = test::make_world(1, {{14, 1.5f, -1, 0.5f}, {30, -4, -1, 0.3f}});
  world.prepared.frame.labels[0].velocity = Vec3d(6, 0, 0);
  world.placement.carrier->label.velocity = Vec3d(6, 0, 0);
  world.prepared.measured_by = record(load_sensors("radar"), "", world.prepared.frame);
  return world;
}

/// Detects the car by the radar: the logit is weights · radar.
class RadarDetector : public Detector {
 public:
  explicit RadarDetector(const Label& car) : car_(car) {}
  std::string name() const override { return "radar cars"; }
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads_image = can.reads_points = false;
    can.reads = {"radar"};
    return can;
  }
  std::array<double, 4> region() const override { return {0, 70, -40, 40}; }
  std::vector<Detection> forward(const SensorView& view, double threshold, bool) override {
    double logit = 0;
    for (const SensorData& sensor : sensors(view, capabilities(), "test")) {
      if (sensor.kind != SensorData::Kind::other) continue;
      EXPECT_EQ(sensor.name, "radar");
      weights = weights_of(sensor.values.size(), 7);
      for (std::size_t i = 0; i < weights.size(); ++i) logit += weights[i] * sensor.values[i];
    }
    asked.push_back(logit);
    Detection found(car_.box.bev, logit);
    return found.score() > threshold ? std::vector<Detection>{found} : std::vector<Detection>{};
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient;
    for (const double weight : weights)
      gradient.others["radar"].push_back(static_cast<float>(d_logits[0] * weight));
    return gradient;
  }
  TrainingLoss train_step(std::span<const TrainingSample>, double) override { return {}; }
  void save(const std::filesystem::path&, bool) override {}

  std::vector<double> weights, asked;

 private:
  Label car_;
};

TEST_F(Sensors, AnAttackFollowsTheGradientThroughASensorThatOnlyItsPluginKnows) {
  const test::World world = with_radar();
  RadarDetector detector(world.prepared.frame.labels[0]);
  const HostId id{"000000", 0};
  const StepHost host{world.prepared, id, world.placement};
  AttackSettings settings;
  settings.objective.lambda_fp = 0;
  const HostStep step = attack_host(detector, host, world.adversary, settings);
  const auto hide = [&](const std::vector<double>& x) {
    TexturedMesh moved = world.adversary;
    for (std::size_t i = 0; i < moved.mesh.vertices.size(); ++i)
      moved.mesh.vertices[i] = Vec3d::Map(x.data() + 3 * i);
    return attack_host(detector, host, moved, settings, false).hide;
  };
  // Measurements are floats: the step is larger than their rounding.
  const auto result = test::check_gradient(hide, test::flat(world.adversary.mesh.vertices),
                                           test::flat(step.gradient.vertices), 1e-3, 3e-2, 0.1);
  EXPECT_GT(result.checked, 100);
  double length = 0;
  for (const Vec3d& d : step.gradient.vertices) length += d.norm();
  EXPECT_GT(length, 0.1);
  settings.target = AttackTarget::lidar;  // it does not include the radar
  for (const Vec3d& d : attack_host(detector, host, world.adversary, settings).gradient.vertices)
    EXPECT_EQ(d, Vec3d(0, 0, 0));
}

TEST_F(Sensors, AFrameAsRecordedAndOneWithAnObjectDifferInTheRadarOnlyWhereTheObjectIs) {
  const test::World world = with_radar();
  const Simulated seen = simulate(world.prepared, world.placement, world.adversary);
  const std::vector<float>&recorded = world.prepared.frame.measurements.at(0).data,
        &with = seen.measurements.at(0).data;
  ASSERT_EQ(recorded.size(), with.size());
  std::size_t changed = 0;
  for (std::size_t i = 0; i < with.size(); ++i) {
    EXPECT_GE(with[i], recorded[i] - 1e-6f);
    changed += with[i] > recorded[i] + 1e-6f;
  }
  EXPECT_GT(changed, 5u);
  EXPECT_LT(changed, with.size() / 20);
  // A detector that does not name it does not get it.
  EXPECT_TRUE(view_of(world.prepared, seen, {}).others.empty());
}

TEST_F(Sensors, AStoreRecordsThemAndKeepsItsCachesApart) {
  const test::TemporaryFolder folder;
  Frame frame = test::make_world(1, {{14, 1.5f, -1, 0.5f}}).prepared.frame;
  frame.id = "000000";
  write_frame(folder.path(), frame);
  FrameSource source;
  source.data = folder.path();
  source.depth = "ip-basic", source.rooftop = "box";
  FrameStore plain(source);
  source.sensors = "radar";
  FrameStore store(source);
  const std::string id = frame.id;
  EXPECT_TRUE(plain.get(id)->frame.measurements.empty());
  const auto held = store.get(id);
  ASSERT_EQ(held->frame.measurements.size(), 1u);
  EXPECT_EQ(held->frame.measurements[0].name, "radar");
  EXPECT_NE(store.content(id), plain.content(id));
}

TEST_F(Sensors, WrongOnesAreRefusedInALine) {
  const auto problem = [](const std::string& words) {
    try {
      load_sensors(words);
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(problem("rader"), testing::HasSubstr("did you mean radar?"));
  EXPECT_THAT(problem("radar,radar"), testing::HasSubstr("two sensors called radar"));
  EXPECT_THAT(problem("/nowhere/sonar.so"), testing::HasSubstr("no such sensor plugin"));
  EXPECT_TRUE(load_sensors("").empty());
}

}  // namespace
}  // namespace mirage
