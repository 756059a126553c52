// What a step tells besides its gradient.
#include <gtest/gtest.h>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/tiny_world.h"
#include "base/files.h"
#include "support/files.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

/// Answers with the same proposals to anything.
class FixedDetector : public test::StandInDetector {
 public:
  explicit FixedDetector(std::vector<Detection> answer) : answer_(std::move(answer)) {}
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    StandInDetector::forward(input, score_threshold, keep_graph);
    return answer_;
  }

 private:
  std::vector<Detection> answer_;
};

AttackSettings settings_for(const test::TemporaryFolder& folder, const char* out, int iterations) {
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.out = folder / out;
  settings.iterations = iterations;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

TEST(AttackStep, AHostIsHiddenWhereItWasFoundAndNoProposalFindsIt) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  const HostId host = find_hosts(store, "000000", {0, 50, -25, 25}, {}).at(0).id;
  const auto prepared = store.get("000000");
  const BevBox box = prepared->frame.labels[0].box.bev;
  const auto hidden = [&](double score, double shift) {
    BevBox found = box;
    found.x += shift;
    FixedDetector detector({{found, std::log(score / (1 - score))}});
    const Detection clean[] = {{box, 1}};
    const auto step = [&](std::span<const Detection> seen) {
      return attack_host(detector, {*prepared, host, store.placement(host), seen}, initial_adversary(),
                         AttackSettings());
    };
    EXPECT_FALSE(step({}).found);
    EXPECT_FALSE(step({}).hidden);  // it was not found in the first place
    EXPECT_TRUE(step(clean).found);
    return step(clean).hidden;
  };
  EXPECT_FALSE(hidden(0.9, 0));
  EXPECT_FALSE(hidden(0.31, 0));
  EXPECT_TRUE(hidden(0.29, 0));                  // below the score of a detection
  EXPECT_FALSE(hidden(0.9, 0.15 * box.length));  // IoU 0.74
  EXPECT_TRUE(hidden(0.9, 0.2 * box.length));    // IoU 0.67
  EXPECT_TRUE(hidden(0.9, 10));
}

TEST(AttackStep, TheLossIsOfEveryTargetAndFalsePositivesCountOnce) {
  const test::World world = test::make_world(1);
  const Label& car = world.placement.targets[0];
  Label other = car;
  other.box.bev.y += 4;
  BevBox nobodys = car.box.bev;
  nobodys.y -= 10;
  FixedDetector detector({{car.box.bev, 0.5}, {other.box.bev, -0.25}, {nobodys, 0.1}});
  const Detection clean[] = {{other.box.bev, 1}};
  const auto judge = [&](std::vector<Label> targets) {
    StepHost host{world.prepared, {}, world.placement, clean};
    host.placement.targets = std::move(targets);
    return judge_host(detector, host, initial_adversary(), AttackSettings());
  };
  const HostStep one = judge({car}), two = judge({car, other});
  EXPECT_NEAR(one.hide, softplus(0.5), 1e-9);
  EXPECT_NEAR(two.hide, softplus(0.5) + softplus(-0.25), 1e-9);
  EXPECT_EQ(two.false_positive, one.false_positive);
  EXPECT_LT(two.false_positive, 0);
  EXPECT_FALSE(one.found);
  EXPECT_TRUE(two.found);
  EXPECT_FALSE(two.hidden);
}

/// Sees returns alone, and knows what they are worth.
class CountingDetector : public test::StandInDetector {
 public:
  Capabilities capabilities() const override {
    Capabilities can = StandInDetector::capabilities();
    can.knows_presence = true;
    return can;
  }
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    watched.assign(input.watched.begin(), input.watched.end());
    const ImageF blank(input.image->width, input.image->height, 3, 0.3f);
    return StandInDetector::forward({&blank, input.points, input.calibration}, score_threshold, keep_graph);
  }
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient = StandInDetector::backward(d_logits);
    for (const LidarPoint& place : watched)
      gradient.presence.push_back(static_cast<float>(kPoints * weight(place) * d_logits[0]));
    return gradient;
  }
  std::vector<LidarPoint> watched;
};

TEST(AttackStep, TheSilhouetteTellsThatALargerObjectCatchesMoreReturns) {
  const test::World world = test::make_world(1);
  // Of the mean over places of the unit's raster.
  std::vector<PreparedFrame> rasters;
  for (int row = 0; row < 8; ++row)
    for (int column = 0; column < 4; ++column) {
      rasters.push_back(world.prepared);
      LidarModel& lidar = rasters.back().lidar;
      for (LidarBeam& beam : lidar.beams) beam.elevation += row / 8. * 0.4 * M_PI / 180;
      lidar.azimuth_min += column / 4. * lidar.azimuth_step,
          lidar.azimuth_max += column / 4. * lidar.azimuth_step;
      rasters.back().index = SweepIndex(world.prepared.frame.sweep, lidar);
    }
  const TexturedMesh mesh = initial_adversary();
  CountingDetector detector;
  AttackSettings settings = test::tiny_attack();
  const auto slope = [&](AttackTarget target, LidarGradient kind) {
    settings.simulation.lidar_gradient = kind;
    settings.target = target;
    double sum = 0;
    for (const PreparedFrame& prepared : rasters) {
      const HostStep step = attack_host(detector, {prepared, {}, world.placement}, mesh, settings);
      for (std::size_t i = 0; i < mesh.mesh.vertices.size(); ++i)
        sum += step.gradient.vertices[i].dot(mesh.mesh.vertices[i]);
    }
    return sum / static_cast<double>(rasters.size());
  };
  const auto hide = [&](double scale) {
    TexturedMesh other = mesh;
    for (Vec3d& v : other.mesh.vertices) v *= scale;
    double sum = 0;
    for (const PreparedFrame& prepared : rasters)
      sum += judge_host(detector, {prepared, {}, world.placement}, other, settings).hide;
    return sum / static_cast<double>(rasters.size());
  };
  const double difference = (hide(1.05) - hide(0.95)) / 0.1;
  EXPECT_LT(difference, -0.01);
  EXPECT_NEAR(slope(AttackTarget::lidar, LidarGradient::silhouette), difference, -0.1 * difference);
  EXPECT_FALSE(detector.watched.empty());
  EXPECT_GT(slope(AttackTarget::lidar, LidarGradient::fixed), 0.7 * difference);
  EXPECT_TRUE(detector.watched.empty());
  slope(AttackTarget::image, LidarGradient::silhouette);  // what reaches no LiDAR is not asked for
  EXPECT_TRUE(detector.watched.empty());
}

TEST(AttackStep, StagesAddUpToTheHostsTime) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  DetectorPool one;
  one.push_back(std::make_unique<test::StandInDetector>());
  auto settings = settings_for(folder, "run", 3);
  settings.expectation = parse_expectation("all");
  const auto stages = run_attack(settings, one).stages;
  double threads = 0;
  for (const auto& [name, seconds] : stages.at("thread_seconds").items()) {
    EXPECT_GE(seconds.get<double>(), 0) << name;
    threads += seconds.get<double>();
  }
  // One thread does all, so its stages are the wall's `hosts`, but for what lies around them.
  EXPECT_LE(threads, stages.at("wall_seconds").at("hosts").get<double>());
  EXPECT_GT(stages.at("thread_seconds").at("worlds").get<double>(), 0);
  EXPECT_EQ(stages.at("iterations"), 3);
  EXPECT_EQ(stages.at("threads"), 1);
}

}  // namespace
}  // namespace mirage
