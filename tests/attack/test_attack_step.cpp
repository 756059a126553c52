// The results of an attack step besides its gradient.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <set>
#include <string>

#include "attack/attack.h"
#include "attack/attack_hosts.h"
#include "attack/attack_step.h"
#include "attack/observation.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "generator/generator.h"
#include "support/files.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

/// Returns the same proposals for any input.
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
    EXPECT_FALSE(step({}).hidden);  // it was not detected without the object either
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
    return attack_host(detector, host, initial_adversary(), AttackSettings(), false);
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

TEST(AttackStep, APhantomsLossLeavesTheHostInPeace) {
  const test::World world = test::make_world(1);
  const BevBox car = world.placement.targets[0].box.bev;
  BevBox nobodys = car;
  nobodys.y -= 10;
  FixedDetector detector({{car, 0.5}, {nobodys, 0.1}});
  StepHost host{world.prepared, {}, world.placement, {}};
  const HostStep hiding = attack_host(detector, host, initial_adversary(), AttackSettings(), false);
  host.placement.victim = Victim::phantom;
  const HostStep phantom = attack_host(detector, host, initial_adversary(), AttackSettings(), false);
  EXPECT_GT(hiding.hide, 0);
  EXPECT_EQ(phantom.hide, 0);
  EXPECT_EQ(phantom.false_positive, hiding.false_positive);
  EXPECT_LT(phantom.false_positive, 0);
}

TEST(AttackStep, TheObjectsOwnBoxIsWhatItHides) {
  test::World world = test::make_world(1);
  world.placement.victim = Victim::object;
  world.placement.targets.clear();
  const TexturedMesh adversary = initial_adversary();
  const Box3 own =
      own_label(world.placement, place(adversary, world.placement).mesh, world.prepared.frame.calibration)
          .box;
  BevBox part = own.bev;
  part.length /= 4;
  const auto step = [&](const Detection& found) {
    FixedDetector detector({found});
    const StepHost host{world.prepared, {}, world.placement, {}};
    return attack_host(detector, host, adversary, AttackSettings(), false);
  };
  const HostStep seen = step({own.bev, 0.5}), in_part = step({part, 0.5}), faint = step({own.bev, -1.5});
  EXPECT_GT(seen.hide, softplus(0.5) - 1e-9);
  EXPECT_TRUE(seen.found);
  EXPECT_FALSE(seen.hidden);
  EXPECT_FALSE(in_part.hidden);  // any box on the host counts as a detection
  EXPECT_TRUE(faint.hidden);     // below the score of a detection
}

// The object is drawn in every camera that the detector names, and the gradient flows back from each.
TEST(AttackStep, OtherCamerasThatTheDetectorNamesAreAttackedToo) {
  test::World world = test::make_world(1);
  Frame frame = world.prepared.frame;
  Calibration beside = frame.calibration;  // half a metre to the right
  beside.camera_from_velo.translation() += Vec3d(-0.5, 0, 0);
  const ImageF recorded(207, 63, 3, 0.6f);
  frame.others.push_back({"ASIDE", beside, Lazy<ImageF>([]() -> ImageF { return {207, 63, 3, 0.1f}; })});
  frame.others.push_back({"BESIDE", beside, Lazy<ImageF>([&] { return recorded; })});
  world.prepared = prepare(frame, world.prepared.lidar);
  const StepHost host{world.prepared, {}, world.placement};
  AttackSettings settings;
  settings.simulation.lidar_gradient = LidarGradient::fixed;
  Observation observation(host, world.adversary, settings.simulation);
  Capabilities can;
  EXPECT_TRUE(observation.view(can, false).others.empty());
  can.reads = {"camera", "BESIDE"};
  const SensorView view = observation.view(can, false);
  ASSERT_EQ(view.others.size(), 1u);
  EXPECT_EQ(view.others[0].name, "BESIDE");
  EXPECT_EQ(view.others[0].image->data, observation.simulated().others[1].image.data);
  EXPECT_NE(view.others[0].image->data, recorded.data);
  SensorGradient gradient;
  RandomStream random(3, "of the camera beside");
  for (std::size_t i = 0; i < recorded.data.size(); ++i)
    gradient.others["BESIDE"].push_back(static_cast<float>(random.uniform(-1, 1)));
  const AdversaryGradient through = observation.vjp(gradient, AttackTarget::both);
  // The same camera as the frame's first, alone.
  Frame alone = frame;
  alone.calibration = beside;
  alone.image = recorded;
  alone.others.clear();
  ImageF d_image(207, 63, 3);
  d_image.data = gradient.others["BESIDE"];
  const Simulated seen = simulate(prepare(alone, world.prepared.lidar), world.placement, world.adversary);
  const AdversaryGradient meant = simulate_vjp(seen, d_image, {});
  ASSERT_EQ(through.vertices.size(), meant.vertices.size());
  double length = 0;
  for (std::size_t i = 0; i < meant.vertices.size(); ++i) {
    EXPECT_EQ(through.vertices[i], meant.vertices[i]);
    length += meant.vertices[i].norm();
  }
  EXPECT_GT(length, 0);
  for (const Vec3d& d : observation.vjp(gradient, AttackTarget::lidar).vertices)  // without the picture
    EXPECT_EQ(d, Vec3d(0, 0, 0));
}

/// Reads the returns alone, and supports presence gradients.
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
  // Averages over 32 offsets of the unit's ray raster.
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
      sum += attack_host(detector, {prepared, {}, world.placement}, other, settings, false).hide;
    return sum / static_cast<double>(rasters.size());
  };
  const double difference = (hide(1.05) - hide(0.95)) / 0.1;
  EXPECT_LT(difference, -0.01);
  EXPECT_NEAR(slope(AttackTarget::lidar, LidarGradient::silhouette), difference, -0.1 * difference);
  EXPECT_FALSE(detector.watched.empty());
  EXPECT_GT(slope(AttackTarget::lidar, LidarGradient::fixed), 0.7 * difference);
  EXPECT_TRUE(detector.watched.empty());
  slope(AttackTarget::image, LidarGradient::silhouette);  // not asked for without LiDAR
  EXPECT_TRUE(detector.watched.empty());
}

TEST(AttackStep, OfTheWorstDrawsTheOneWithTheGreatestLossGivesTheGradient) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  const HostId id = find_hosts(store, "000000", {0, 50, -25, 25}, {}).at(0).id;
  const auto prepared = store.get("000000");
  test::StandInDetector detector;
  const StepHost host{*prepared, id, store.placement(id)};
  AttackSettings settings = test::tiny_attack();
  settings.expectation = parse_expectation("shape:0.05,colour,worst:5");
  const TexturedMesh mesh = random_adversary(2);
  std::set<int> chosen;
  for (std::uint64_t number = 0; number < 12; ++number) {
    std::vector<HostStep> all;
    for (int k = 0; k < 5; ++k) {
      const SampledEnvironment draw(settings.expectation, settings.seed, candidate_draw(number, k));
      StepHost in_world = host;
      in_world.draw = &draw;
      all.push_back(attack_host(detector, in_world, mesh, settings));
    }
    const auto worst = std::max_element(all.begin(), all.end(), [](const HostStep& a, const HostStep& b) {
      return a.hide + a.false_positive < b.hide + b.false_positive;
    });
    chosen.insert(static_cast<int>(worst - all.begin()));
    const HostStep step = step_host(detector, host, mesh, settings, number, true);
    EXPECT_EQ(step.hide, worst->hide);
    EXPECT_EQ(step.false_positive, worst->false_positive);
    EXPECT_EQ(step.gradient.vertices, worst->gradient.vertices);
    EXPECT_EQ(step.gradient.texels, worst->gradient.texels);
    const HostStep judged = step_host(detector, host, mesh, settings, number, false);
    EXPECT_EQ(judged.hide, worst->hide);
    EXPECT_TRUE(judged.gradient.vertices.empty());
  }
  EXPECT_GE(chosen.size(), 3u) << "it is not always the same one";

  // Without `worst` each step uses its one draw; without any expectation it uses the world as recorded.
  settings.expectation.worst = 0;
  const SampledEnvironment draw(settings.expectation, settings.seed, 7);
  StepHost in_world = host;
  in_world.draw = &draw;
  EXPECT_EQ(step_host(detector, host, mesh, settings, 7, true).gradient.vertices,
            attack_host(detector, in_world, mesh, settings).gradient.vertices);
  settings.expectation = {};
  EXPECT_EQ(step_host(detector, host, mesh, settings, 7, true).gradient.vertices,
            attack_host(detector, host, mesh, settings).gradient.vertices);
}

TEST(AttackStep, TheWorstDrawsAreTheSameForAnyNumberOfThreadsAndAfterAStop) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  const auto learned = [&](const char* out, std::size_t threads, std::vector<int> stops) {
    DetectorPool pool;
    for (std::size_t i = 0; i < threads; ++i) pool.push_back(std::make_unique<test::StandInDetector>());
    for (const int iterations : stops) {
      auto settings = settings_for(folder, out, iterations);
      settings.expectation = parse_expectation("shape:0.02,colour,worst:3");
      run_attack(settings, pool);
    }
    return read_file(folder / out / "adversary.glb");
  };
  const std::string one = learned("one", 1, {5});
  EXPECT_EQ(learned("three", 3, {5}), one);
  EXPECT_EQ(learned("stopped", 2, {2, 5}), one);
}

TEST(AttackStep, WeightsThatNoStepBearsAreNamed) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  for (const double weight : {1e308, std::numeric_limits<double>::max()}) {
    auto settings = settings_for(folder, "run", 5);
    settings.objective.lambda_laplacian = weight;
    settings.vertex_rate = 0.05;
    try {
      run_attack(settings, test::one_of<test::StandInDetector>());  // otherwise every step is finite
    } catch (const Failure& failure) {
      EXPECT_THAT(failure.what(),
                  testing::AllOf(testing::HasSubstr("not finite"), testing::HasSubstr("--lambda-lap")));
    }
  }
}

// A pixel that noise clips to [0, 1] carries no gradient.
TEST(AttackStep, NoGradientComesThroughPixelsThatNoiseClips) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  const HostId id = find_hosts(store, "000000", {0, 50, -25, 25}, {}).at(0).id;
  const auto prepared = store.get("000000");
  test::StandInDetector detector;
  AttackSettings settings = test::tiny_attack();
  settings.target = AttackTarget::image;
  TexturedMesh black = initial_adversary();
  for (Vec3d& texel : black.atlas.texels) texel.setZero();
  const auto gradient = [&](double noise) {
    EotSettings expectation;
    expectation.image_noise = noise;
    const SampledEnvironment draw(expectation, 1, 2);
    StepHost host{*prepared, id, store.placement(id)};
    host.draw = &draw;
    double sum = 0;
    for (const Vec3d& d : attack_host(detector, host, black, settings).gradient.texels) sum += d.sum();
    return sum;
  };
  const double exact = gradient(0), noisy = gradient(0.01);
  ASSERT_NE(exact, 0);
  // Half of the draws are below 0, where black pixels clip. Pixels on the outline do not: they mix in the
  // grey photograph. The detector's slope is the same everywhere.
  EXPECT_GT(noisy / exact, 0.5);
  EXPECT_LT(noisy / exact, 0.85);
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
  // One thread does all the work, so its stages sum to at most the wall time `hosts`.
  EXPECT_LE(threads, stages.at("wall_seconds").at("hosts").get<double>());
  EXPECT_GT(stages.at("thread_seconds").at("worlds").get<double>(), 0);
  EXPECT_EQ(stages.at("iterations"), 3);
  EXPECT_EQ(stages.at("threads"), 1);
}

}  // namespace

// The order in which an attack meets its hosts.

namespace {

/// Frame f has counts[f] hosts.
std::vector<Host> hosts_in_frames(const std::vector<int>& counts) {
  std::vector<Host> hosts;
  for (std::size_t f = 0; f < counts.size(); ++f)
    for (int k = 0; k < counts[f]; ++k) hosts.push_back({{"frame" + std::to_string(f), k}, {}});
  return hosts;
}

/// The hosts at position `place` of the first `n` batches.
std::vector<std::size_t> met(const HostOrder& order, std::size_t place, long n) {
  std::vector<std::size_t> hosts;
  for (long i = 0; i < n; ++i) hosts.push_back(order.batch(i).at(place));
  return hosts;
}

TEST(HostOrder, EveryPassOfALaneMeetsEveryHostOnce) {
  const auto hosts = hosts_in_frames(std::vector<int>(10, 3));
  const HostOrder order(hosts, 2, 5);
  ASSERT_EQ(order.lanes(), 2u);
  std::set<std::vector<std::size_t>> passes;
  std::set<std::size_t> all;
  for (const std::size_t place : {0u, 1u}) {
    const auto two = met(order, place, 30);
    for (const std::size_t pass : {0u, 1u}) {
      const std::vector<std::size_t> one(two.begin() + static_cast<long>(15 * pass),
                                         two.begin() + static_cast<long>(15 * pass + 15));
      EXPECT_EQ(std::set<std::size_t>(one.begin(), one.end()).size(), 15u);
      EXPECT_TRUE(passes.insert(one).second) << "another pass in the same order";
    }
    all.insert(two.begin(), two.end());
  }
  EXPECT_EQ(all.size(), hosts.size()) << "lanes do not share hosts";
}

TEST(HostOrder, LanesAndTheProcessesThatHaveThemShareNoFrame) {
  const auto hosts = hosts_in_frames({9, 1, 4, 7, 2, 2, 6, 3, 5, 8});
  const HostOrder order(hosts, 4, 1);
  ASSERT_EQ(order.lanes(), 4u);
  std::map<std::string, std::set<std::size_t>> processes;  // by frame, with two processes
  for (long i = 0; i < 60; ++i) {
    const auto batch = order.batch(i);
    for (std::size_t k = 0; k < batch.size(); ++k) processes[hosts[batch[k]].id.frame].insert(k % 2);
  }
  EXPECT_EQ(processes.size(), 10u);
  for (const auto& [frame, of] : processes) EXPECT_EQ(of.size(), 1u) << frame;
}

TEST(HostOrder, AFrameIsOpenedOnceAPassAndFewAreOpenAtATime) {
  const std::size_t frames = 60;
  const auto hosts = hosts_in_frames(std::vector<int>(frames, 8));
  const HostOrder order(hosts, 2, 3);
  const auto pass = met(order, 0, static_cast<long>(hosts.size() / 2));
  std::map<std::string, std::pair<std::size_t, std::size_t>> span;  // each frame's first and last batch
  for (std::size_t i = 0; i < pass.size(); ++i) {
    const auto [known, fresh] = span.try_emplace(hosts[pass[i]].id.frame, i, i);
    known->second.second = i;
  }
  ASSERT_EQ(span.size(), frames / 2);
  std::size_t most = 0, neighbours = 0;
  for (std::size_t i = 0; i < pass.size(); ++i) {
    std::size_t open = 0;
    for (const auto& [frame, of] : span) open += of.first <= i && i <= of.second;
    most = std::max(most, open);
    neighbours += i > 0 && hosts[pass[i]].id.frame == hosts[pass[i - 1]].id.frame;
  }
  EXPECT_LE(most, kOpenFrames / 2);
  EXPECT_GT(most, 1u) << "hosts of a frame come mixed with others";
  EXPECT_LT(neighbours, pass.size() / 3) << "and not one after another";
}

TEST(HostOrder, ABatchLargerThanTheFramesOrUnevenFramesMakeFewerLanes) {
  EXPECT_EQ(HostOrder(hosts_in_frames({3, 3}), 8, 0).lanes(), 2u);
  EXPECT_EQ(HostOrder(hosts_in_frames({5}), 2, 0).lanes(), 1u);
  const auto uneven = hosts_in_frames({10, 1, 1});  // on two lanes, hosts of the small frames came five times
  const HostOrder one(uneven, 2, 0);
  EXPECT_EQ(one.lanes(), 1u);
  std::map<std::size_t, int> times;
  for (long i = 0; i < 12; ++i)
    for (const std::size_t host : one.batch(i)) ++times[host];
  ASSERT_EQ(times.size(), 12u);
  for (const auto& [host, n] : times) EXPECT_EQ(n, 2) << host;
}

TEST(HostOrder, ABatchMeetsNoHostTwice) {
  for (const auto& counts : {std::vector<int>{1, 1, 1}, std::vector<int>{7}, std::vector<int>{9, 1, 2}}) {
    const auto hosts = hosts_in_frames(counts);
    for (const int batch : {2, 3}) {
      if (hosts.size() < 3 * as_size(batch - 1)) continue;
      for (std::uint64_t seed = 0; seed < 20; ++seed) {
        const HostOrder order(hosts, batch, seed);
        std::map<std::size_t, int> times;
        for (long i = 0; i < static_cast<long>(hosts.size()); ++i) {
          const auto met = order.batch(i);
          EXPECT_EQ(std::set<std::size_t>(met.begin(), met.end()).size(), met.size());
          for (const std::size_t host : met) ++times[host];
        }
        if (order.lanes() > 1) continue;
        for (const auto& [host, n] : times) EXPECT_EQ(n, batch) << "every pass is whole";
      }
    }
  }
}

TEST(HostOrder, TheSeedDecidesTheOrder) {
  const auto hosts = hosts_in_frames(std::vector<int>(12, 4));
  const auto first = met(HostOrder(hosts, 2, 1), 0, 24);
  EXPECT_EQ(met(HostOrder(hosts, 2, 1), 0, 24), first);
  EXPECT_NE(met(HostOrder(hosts, 2, 2), 0, 24), first);
  EXPECT_EQ(HostOrder(hosts, 2, 1).batch(17).at(0), first[17])
      << "any iteration by itself, as a resumed run asks";
}

}  // namespace

// No stop-gradient anywhere: the gradient flows from a proposal's logit of the real detector to the
// adversary, one sensor at a time.

namespace {

struct Norms {
  double vertices = 0, texels = 0;
};

Norms norms(const AdversaryGradient& gradient) {
  Norms result;
  for (const Vec3d& d : gradient.vertices) {
    EXPECT_TRUE(d.allFinite());
    result.vertices += d.norm();
  }
  for (const Vec3d& d : gradient.texels) {
    EXPECT_TRUE(d.allFinite());
    result.texels += d.norm();
  }
  return result;
}

/// The adversary on a car 12 m ahead in an otherwise empty street.
TEST(GradientFlow, FromALogitToTheAdversaryThroughEachSensorAlone) {
  if (!std::filesystem::exists(executable_folder() / "plugins/fusion.so"))
    GTEST_SKIP() << "the fusion plugin was not built (MIRAGE_DETECTORS)";
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  DetectorOptions options;
  options.fresh = true;
  options.seed = 3;
  options.threads = 1;
  const auto detector = load_detector(options);

  const Rig rig = read_rig(shipped_file("scenes/rigs/kitti64.toml"));
  Frame frame;
  frame.calibration = rig.calibration;
  frame.image = ImageF(rig.calibration.camera.width, rig.calibration.camera.height, 3, 0.3f);
  for (double x = 6; x < 40; x += 0.5)
    for (double y = -6; y <= 6; y += 0.3) frame.sweep.push_back({float(x), float(y), -1.73f, 0.2f});
  Label host;
  host.type = "Car";
  host.box = {{12, 0.5, 4, 1.7, 0.1}, -1.73, 1.5};
  frame.labels = {host};
  const PreparedFrame prepared = prepare(frame, rig.lidar);
  const Simulated simulated =
      simulate(prepared, on_roof(BoxRoofFinder().find(frame, host)), random_adversary(1));
  ASSERT_GT(simulated.adversary_pixels, 500);
  ASSERT_GT(simulated.adversary_points, 20);

  const SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration};
  const auto proposals = detector->forward(view, 0, true);
  ASSERT_FALSE(proposals.empty());
  std::size_t nearest = 0;
  const auto distance = [&](const Detection& p) { return std::hypot(p.box.bev.x - 12, p.box.bev.y - 0.5); };
  for (std::size_t i = 0; i < proposals.size(); ++i)
    if (distance(proposals[i]) < distance(proposals[nearest])) nearest = i;
  std::vector<double> d_logits(proposals.size(), 0);
  d_logits[nearest] = 1;
  const SensorGradient gradient = detector->backward(d_logits);

  const Norms lidar = norms(simulate_vjp(simulated, ImageF(), gradient.points));
  const Norms image = norms(simulate_vjp(simulated, gradient.image, {}));
  std::printf("|d logit / d vertices| LiDAR %.2e, image %.2e; |d logit / d texels| image %.2e\n",
              lidar.vertices, image.vertices, image.texels);
  EXPECT_GT(lidar.vertices, 0);
  EXPECT_EQ(lidar.texels, 0);  // reflectivity belongs to the material, not to the texels
  EXPECT_GT(image.vertices, 0);
  EXPECT_GT(image.texels, 0);
}

}  // namespace
}  // namespace mirage
