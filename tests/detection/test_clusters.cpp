// The detector without training (--detector clusters), on sweeps of existing LiDAR units.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <thread>

#include "base/error.h"
#include "base/random.h"
#include "base/types.h"
#include "detection/detector.h"
#include "detection/plugin_detector.h"
#include "geometry/mesh.h"
#include "support/files.h"

#ifdef MIRAGE_HAS_CLUSTERS

namespace mirage {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr int kCarType = 0, kMiscType = 1;

/// The plugin's detector, with objects that are not cars.
std::unique_ptr<Detector> any_things() {
  DetectorOptions options;
  options.detector = "clusters";
  return open_detector(plugin_file(options), "clusters", "{}", {});
}

/// A thing may be both a car and not a car; this keeps the likelier of the two.
std::vector<Detection> found_in(const std::vector<LidarPoint>& sweep, double score = 0.05) {
  auto all = any_things()->forward({nullptr, sweep, nullptr}, score, false);
  std::stable_sort(all.begin(), all.end(),
                   [](const Detection& a, const Detection& b) { return a.logit > b.logit; });
  std::vector<Detection> likelier;
  for (const Detection& one : all)
    if (std::none_of(likelier.begin(), likelier.end(), [&](const Detection& better) {
          const auto inside = [](const BevBox& box, const BevBox& other) {
            return contains({box, -1, 2}, {other.x, other.y, 0}, 0.2);
          };
          return inside(better.box.bev, one.box.bev) || inside(one.box.bev, better.box.bev);
        }))
      likelier.push_back(one);
  return likelier;
}

LidarModel unit_of(const std::string& rig) {
  return read_lidar_model(MIRAGE_SOURCE "/scenes/rigs/" + rig + ".toml");
}

/// A unit's returns from a road and boxes on it, with 2 cm of noise.
class BoxWorld {
 public:
  using Road = std::function<double(double, double)>;

  explicit BoxWorld(
      std::string rig = "kitti64", Road bumps = [](double, double) { return 0.0; })
      : unit_(unit_of(rig)), road_([height = unit_.height, over = std::move(bumps)](double x, double y) {
          return over(x, y) - height;
        }) {
    constexpr int kSide = 160;  // m
    Mesh ground;
    for (int row = 0; row <= kSide; ++row)
      for (int column = 0; column <= kSide; ++column) {
        const double x = row - kSide / 2.0, y = column - kSide / 2.0;
        ground.vertices.emplace_back(x, y, road_(x, y));
      }
    for (int row = 0; row < kSide; ++row)
      for (int column = 0; column < kSide; ++column) {
        const int a = row * (kSide + 1) + column, b = a + kSide + 1;
        ground.faces.push_back({a, b, b + 1});
        ground.faces.push_back({a, b + 1, a + 1});
      }
    meshes_.push_back(std::move(ground));
  }

  /// Adds a box that stands on the road.
  BoxWorld& with(const BevBox& box, double height, double lift = 0) {
    Transform place = velo_from_box({box, road_(box.x, box.y) + lift, height});
    place.translate(Vec3d(0, 0, height / 2));
    Mesh mesh;
    append(mesh, box_mesh({box.length, box.width, height}), place);
    meshes_.push_back(std::move(mesh));
    return *this;
  }
  double road(double x, double y) const { return road_(x, y); }

  std::vector<LidarPoint> sweep() const {
    const RayCaster caster(meshes_);
    RandomStream random(7, "clusters");
    std::vector<LidarPoint> points;
    for (int beam = 0; beam < static_cast<int>(unit_.beams.size()); ++beam)
      for (int column = 0; column < unit_.azimuth_count(); ++column) {
        const LidarRay ray = unit_.ray(beam, column);
        const Hit hit = caster.intersect({ray.origin.cast<float>(), ray.direction.cast<float>(), 1, 120});
        if (!hit.hit()) continue;
        const Vec3d p = ray.origin + (hit.t + 0.02 * random.normal()) * ray.direction;
        points.push_back(
            {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()), 0.3f});
      }
    return points;
  }

 private:
  LidarModel unit_;
  Road road_;
  std::vector<Mesh> meshes_;
};

/// The detection whose box holds the place.
const Detection* at(const std::vector<Detection>& found, double x, double y) {
  const auto one = std::find_if(found.begin(), found.end(), [&](const Detection& detection) {
    Box3 around = detection.box;
    around.bottom = -1, around.height = 2;
    return contains(around, {x, y, 0}, 0.15);
  });
  return one == found.end() ? nullptr : &*one;
}

TEST(Clusters, FindsBoxesWithHeightsOfCarsAndOfAnythingElse) {
  const auto detector = any_things();
  EXPECT_EQ(detector->name(), "clusters");
  const Capabilities can = detector->capabilities();
  EXPECT_TRUE(can.finds_bev && can.finds_heights && can.reads_points);
  EXPECT_FALSE(can.reads_image || can.finds_picture || can.has_gradients || can.remembers);
  EXPECT_THAT(can.types, testing::ElementsAre("Car", "Misc"));
  EXPECT_THROW(detector->backward(std::vector<double>{}), Failure);
}

TEST(Clusters, TheRoadIsNothing) {
  for (const char* rig : {"kitti64", "nuscenes"}) {
    EXPECT_TRUE(found_in(BoxWorld(rig).sweep()).empty()) << rig;
    const auto tilted = [](double x, double y) { return 0.07 * x - 0.04 * y; };
    EXPECT_TRUE(found_in(BoxWorld(rig, tilted).sweep()).empty()) << rig;
    const auto bumpy = [&](double x, double y) {
      return tilted(x, y) + 0.06 * std::sin(x / 2) * std::cos(y / 3);
    };
    EXPECT_TRUE(found_in(BoxWorld(rig, bumpy).sweep()).empty()) << rig;
    const auto hill = [](double x, double) { return x > 15 ? 0.002 * (x - 15) * (x - 15) : 0; };
    EXPECT_TRUE(found_in(BoxWorld(rig, hill).sweep()).empty()) << rig;
  }
}

TEST(Clusters, EchoesFromBelowAreNoGround) {
  auto sweep = BoxWorld().with({20, -4, 0.8, 0.8, 0}, 0.9).sweep();
  RandomStream random(5, "echoes");
  for (int i = 0; i < 300; ++i)
    sweep.push_back({static_cast<float>(random.uniform(8, 40)), static_cast<float>(random.uniform(-6, 6)),
                     static_cast<float>(random.uniform(-3.5, -2.6)), 0.3f});
  const auto found = found_in(sweep);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_TRUE(at(found, 20, -4));
  EXPECT_NEAR(found[0].box.bottom, -1.73, 0.12);
}

TEST(Clusters, WhatStandsOnATiltedRoadIsFoundAtItsPlace) {
  BoxWorld world("kitti64", [](double x, double y) { return 0.05 * x + 0.03 * y; });
  world.with({15, 3, 4.1, 1.7, 0.4}, 1.5).with({20, -4, 0.8, 0.8, 0}, 0.9);
  const auto found = found_in(world.sweep());
  ASSERT_EQ(found.size(), 2u);
  const Detection *car = at(found, 15, 3), *crate = at(found, 20, -4);
  ASSERT_TRUE(car && crate);
  EXPECT_EQ(car->type, kCarType);
  EXPECT_EQ(crate->type, kMiscType);
  for (const auto& [detection, height] : {std::pair(car, 1.5), std::pair(crate, 0.9)}) {
    EXPECT_NEAR(detection->box.bottom, world.road(detection->box.bev.x, detection->box.bev.y), 0.12);
    EXPECT_NEAR(detection->box.height, height, 0.15);
  }
}

TEST(Clusters, ObjectsOnTheRoadAreFoundFarAway) {
  for (const double side : {0.5, 1.0})
    for (const double distance : {10.0, 20.0, 40.0}) {
      const auto found = found_in(BoxWorld().with({distance, 1, side, side, 0.3}, side).sweep());
      ASSERT_EQ(found.size(), 1u) << side << " m at " << distance;
      const Detection& cube = found[0];
      EXPECT_EQ(cube.type, kMiscType);
      EXPECT_LT(std::hypot(cube.box.bev.x - distance, cube.box.bev.y - 1), 0.75 * side);
      EXPECT_LT(cube.box.bev.length, side + 0.35);
      EXPECT_NEAR(cube.box.height, side, 0.3);
    }
  for (const double distance : {10.0, 20.0}) {  // 32 beams
    const auto found = found_in(BoxWorld("nuscenes").with({distance, 1, 1, 1, 0.3}, 1).sweep());
    ASSERT_EQ(found.size(), 1u) << distance;
    EXPECT_LT(std::hypot(found[0].box.bev.x - distance, found[0].box.bev.y - 1), 0.75);
  }
  // The score depends on how much of it is visible.
  const auto score = [](double side, double distance) {
    return found_in(BoxWorld().with({distance, 1, side, side, 0.3}, side).sweep())[0].score();
  };
  EXPECT_GT(score(0.5, 10), score(0.5, 40));
  EXPECT_GT(score(1.0, 40), score(0.5, 40));
  EXPECT_GT(score(0.5, 20), 0.5);
}

TEST(Clusters, ThingsWithAGapAreTwo) {
  const auto count = [](double gap) {
    return found_in(BoxWorld()
                        .with({12, -0.5 - gap / 2, 1, 1, 0}, 1)
                        .with({12, 0.5 + gap / 2, 1, 1, 0}, 1)
                        .sweep())
        .size();
  };
  EXPECT_EQ(count(0.6), 2u);
  EXPECT_EQ(count(0.2), 1u);  // closer than the clustering distance
}

TEST(Clusters, APolesShadowLeavesOneThingAndAWideOneParts) {
  const auto pieces = [](double pole) {
    BoxWorld world;
    world.with({16, 0, 0.5, 5, 0}, 1.2).with({9, 0, pole, pole, 0}, 2.2);
    const auto found = found_in(world.sweep());
    return std::count_if(found.begin(), found.end(), [](const Detection& one) { return one.box.bev.x > 13; });
  };
  EXPECT_EQ(pieces(0.15), 1);  // 0.27 m of shadow
  EXPECT_EQ(pieces(0.6), 2);   // 1.1 m: nothing shows that both parts belong together
}

TEST(Clusters, ACarSeenFromItsCornerKeepsHeadingAndSize) {
  for (const double yaw : {0.7, 1.0, -0.6, 2.2}) {
    const BevBox car{14, 4, 4.2, 1.75, yaw};
    const auto found = found_in(BoxWorld().with(car, 1.5).sweep());
    ASSERT_EQ(found.size(), 1u) << yaw;
    EXPECT_EQ(found[0].type, kCarType);
    const BevBox& box = found[0].box.bev;
    EXPECT_LT(std::abs(std::remainder(box.yaw - yaw, M_PI)), 2 * kDegree) << yaw;
    EXPECT_NEAR(box.length, car.length, 0.15) << yaw;
    EXPECT_NEAR(box.width, car.width, 0.15) << yaw;
    EXPECT_GT(iou(box, car), 0.8) << yaw;
  }
}

TEST(Clusters, WhatIsNoCarIsCalledMisc) {
  const auto type = [](const BevBox& box, double height) {
    const auto found = found_in(BoxWorld().with(box, height).sweep());
    return found.size() == 1 ? found[0].type : -1;
  };
  EXPECT_EQ(type({15, 3, 4.1, 1.7, 0.4}, 1.5), kCarType);
  EXPECT_EQ(type({15, 3, 4.1, 1.7, 0.4}, 0.6), kMiscType);                         // too low
  EXPECT_EQ(type({15, 3, 0.5, 0.6, 0.4}, 1.7), kMiscType);                         // a pedestrian
  EXPECT_EQ(type({15, 3, 9.0, 2.4, 0.4}, 2.3), kMiscType);                         // a lorry
  EXPECT_TRUE(found_in(BoxWorld().with({15, 3, 0.5, 40, 0}, 2).sweep()).empty());  // a wall
}

TEST(Clusters, WhatHangsOverTheRoadJoinsNothing) {
  const BevBox car{30, 1, 4.1, 1.7, 0.1};
  BoxWorld world;
  world.with(car, 1.5).with({30, 1, 9, 9, 0}, 0.5, 2.65);
  const auto sweep = world.sweep();
  ASSERT_GT(std::count_if(sweep.begin(), sweep.end(), [](const LidarPoint& p) { return p.z > 0.85; }), 20);
  const auto found = found_in(sweep);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_GT(iou(found[0].box.bev, car), 0.7);
}

TEST(Clusters, SweepsThatAreHardlyAnyHaveFiniteAnswers) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              infinite = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(found_in({}).empty());
  EXPECT_TRUE(found_in({{10, 1, -1, 0.3f}}, 0).empty());
  EXPECT_TRUE(found_in({{0, 0, 0, 0.3f}}, 0).empty());
  EXPECT_TRUE(found_in({{nan, 1, 0, 0}, {1, infinite, 0, 0}, {1, 1, nan, nan}}, 0).empty());
  std::vector<LidarPoint> line, column, far, same(50, LidarPoint{12, 3, 0, 0.3f});
  for (int i = 0; i < 200; ++i) {
    line.push_back({5 + 0.1f * static_cast<float>(i), 0, -1, 0.3f});
    column.push_back({12, 3, -1.7f + 0.02f * static_cast<float>(i), 0.3f});
    far.push_back({1e30f, -1e30f * static_cast<float>(i % 3), 1e30f, 0.3f});
  }
  for (const auto& sweep : {line, column, far, same})
    for (const Detection& one : found_in(sweep, 0)) {  // checked by check_proposals, too
      EXPECT_TRUE(std::isfinite(one.logit) && std::isfinite(one.box.bottom) && one.box.height > 0);
      EXPECT_TRUE(one.box.bev.length > 0 && one.box.bev.width > 0 && std::isfinite(one.box.bev.yaw));
    }
  auto sweep = BoxWorld().with({15, 3, 4.1, 1.7, 0.4}, 1.5).sweep();
  const auto clean = found_in(sweep);
  sweep.insert(sweep.begin(), {nan, nan, nan, nan});
  const auto dirty = found_in(sweep);
  ASSERT_EQ(dirty.size(), clean.size());
  EXPECT_EQ(dirty[0].logit, clean[0].logit);
}

TEST(Clusters, AnyNumberOfThreadsAnswersTheSame) {
  const auto sweep = BoxWorld().with({15, 3, 4.1, 1.7, 0.4}, 1.5).with({20, -4, 0.8, 0.8, 0}, 0.9).sweep();
  const auto detector = any_things();
  const SensorView view{nullptr, sweep, nullptr};
  const auto alone = detector->forward(view, 0.05, false);
  std::vector<std::vector<Detection>> together(4);
  std::vector<std::thread> threads;
  for (auto& found : together)
    threads.emplace_back([&, mine = detector->share()] {
      for (int k = 0; k < 3; ++k) found = mine->forward(view, 0.05, false);
    });
  for (std::thread& thread : threads) thread.join();
  for (const auto& found : together) {
    ASSERT_EQ(found.size(), alone.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
      EXPECT_EQ(found[i].logit, alone[i].logit);
      EXPECT_EQ(found[i].box.bev.x, alone[i].box.bev.x);
      EXPECT_EQ(found[i].box.bev.yaw, alone[i].box.bev.yaw);
    }
  }
}

TEST(Clusters, TheThresholdOnlyLeavesOut) {
  const auto sweep = BoxWorld().with({15, 3, 4.1, 1.7, 0.4}, 1.5).with({40, -4, 0.5, 0.5, 0}, 0.5).sweep();
  const SensorView view{nullptr, sweep, nullptr};
  const auto all = any_things()->forward(view, 0, false);
  ASSERT_EQ(all.size(), 3u);  // the car as a car and as something else, and the cube
  std::vector<double> scores;
  for (const Detection& one : all) scores.push_back(one.score());
  std::sort(scores.begin(), scores.end());
  EXPECT_EQ(any_things()->forward(view, scores[0] + 1e-6, false).size(), 2u);
  EXPECT_EQ(any_things()->forward(view, scores[1] + 1e-6, false).size(), 1u);
}

TEST(Clusters, NeedsNoWeightsAndTakesAPictureNetworks) {
  DetectorOptions options;
  options.detector = "clusters";
  EXPECT_TRUE(weights_file(options).empty());
  EXPECT_FALSE(weights_hash(options).empty());
  EXPECT_TRUE(auxiliary_detectors(options).empty());
  const auto alone = load_detector(options);
  EXPECT_EQ(alone->name(), "clusters");
  EXPECT_FALSE(alone->capabilities().reads_image);
  const auto message_of = [&] { return test::error_text<InputError>([&] { load_detector(options); }); };
  options.defense = "adversarial";
  EXPECT_THAT(message_of(), AllOf(HasSubstr("defense"), HasSubstr("use none, ceiling:HEIGHT or shadows")));
  options.defense = "none";
  for (const char* file : {"gone.weights", "gone.pt"}) {
    options.weights = file;
    EXPECT_THAT(message_of(), AllOf(HasSubstr("no such"), Not(HasSubstr("\n")))) << file;
  }
  options.weights = kRealWeights;
  EXPECT_THAT(message_of(), HasSubstr("no shipped weights of camera"));
#ifdef MIRAGE_HAS_FUSION
  options.weights = MIRAGE_BUILD "/plugins/weights/camera-kitti64.weights";
  const auto fused = load_detector(options);
  EXPECT_EQ(fused->name(), "clusters");
  EXPECT_TRUE(fused->capabilities().reads_image && fused->capabilities().reads_points);
  EXPECT_FALSE(fused->capabilities().has_gradients);
  EXPECT_EQ(auxiliary_detectors(options).size(), 1u);
  options.weights = MIRAGE_BUILD "/plugins/weights/lidar-kitti64.weights";
  EXPECT_THAT(message_of(), Not(HasSubstr("\n")));
#endif
}

TEST(Clusters, AnswersForTheClassesThatAreSought) {
  const auto sweep = BoxWorld().with({15, 3, 4.1, 1.7, 0.4}, 1.5).with({20, -4, 0.8, 0.8, 0}, 0.9).sweep();
  const auto found = [&](const std::string& classes) {
    DetectorOptions options;
    options.detector = "clusters";
    options.classes = classes;
    return load_detector(options)->forward({nullptr, sweep, nullptr}, 0.3, false);
  };
  const auto cars = found("Car"), things = found("Pedestrian"), all = found("Car,Misc");
  ASSERT_EQ(cars.size(), 1u);  // the crate is no false alarm
  EXPECT_TRUE(at(cars, 15, 3));
  ASSERT_EQ(things.size(), 1u);
  EXPECT_TRUE(at(things, 20, -4));
  EXPECT_EQ(all.size(), 2u);
}

TEST(Clusters, CannotBeTrained) {
  const auto detector = any_things();
  const std::vector<TrainingSample> none;
  EXPECT_THAT(test::error_text<Failure>([&] { detector->train_step(none, 1e-3); }),
              AllOf(HasSubstr("has no train_step"), Not(HasSubstr("\n"))));
}

}  // namespace
}  // namespace mirage

#endif
