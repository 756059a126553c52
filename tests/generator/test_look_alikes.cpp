// Look-alikes and what is on roofs: what the camera and the LiDAR make of them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "generator/generator.h"
#include "generator/looks/american_parts.h"
#include "generator/street.h"
#include "generator/vehicle_truth.h"
#include "geometry/shapes.h"
#include "sensors/lidar_sweep.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

using generator::Actor;

/// The sweep of one thing that stands 12 m ahead on open ground.
Sweep seen_by_lidar(Actor actor, std::vector<int>* objects) {
  std::vector<Surface> surfaces;
  Mesh ground;
  generator::add_quad(ground, {-80, -80, -1.73}, {80, -80, -1.73}, {80, 80, -1.73}, {-80, 80, -1.73});
  surfaces.push_back(generator::surface(ground, generator::plain(Vec3f::Constant(0.1f), 0.3f)));
  for (Surface& s : actor.surfaces) {
    for (Vec3d& v : s.mesh.vertices) v = generator::at(12, 2, -1.73, 0.4) * v;
    s.object = 0;
    surfaces.push_back(std::move(s));
  }
  return simulate_sweep(RayScene(surfaces), test::small_rig().lidar, 5, generated_sweep_effects(), objects);
}

// The same mesh with the same panes and reflectivities: the LiDAR gets the same returns, but for the pattern
// of a car's grille. To the camera nothing of a car is left: no pane, no gloss, no light.
TEST(LookAlikes, DifferFromCarsInPixelsOnly) {
  int covered = 0;
  for (std::uint64_t i = 0; i < 12; ++i) {
    RandomStream random(3, "look-alike", i);
    const Actor car = i % 2 ? generator::american::make_car(random) : generator::make_car(random);
    const Actor alike = generator::make_look_alike(car, random);
    EXPECT_EQ(alike.type, "Misc");
    EXPECT_EQ(alike.kind, "look-alike");
    for (const Surface& s : alike.surfaces) {
      if (!s.material.veiled) continue;  // a boat's trailer
      EXPECT_EQ(seen_through(s.material), 0);
      EXPECT_EQ(surface_gloss(s.material, {1, 2, 3}, Vec3f::UnitX()), 0);
      EXPECT_EQ(s.material.emission, Vec3f::Zero());
    }
    if (alike.surfaces.size() <= car.surfaces.size()) continue;  // a bin, a shed, a boat
    ++covered;
    EXPECT_EQ(alike.size, car.size);
    std::vector<int> of_car, of_alike;
    const Sweep a = seen_by_lidar(car, &of_car), b = seen_by_lidar(alike, &of_alike);
    const auto hits = [](const std::vector<int>& objects) {
      return static_cast<double>(std::count(objects.begin(), objects.end(), 0));
    };
    ASSERT_GT(hits(of_car), 60);
    EXPECT_NEAR(hits(of_alike), hits(of_car), 0.02 * hits(of_car) + 2);
    ASSERT_NEAR(static_cast<double>(a.size()), static_cast<double>(b.size()), 6);
    std::size_t same = 0, j = 0;
    for (const LidarPoint& p : a) {  // both in the order of firing
      std::size_t k = j;
      while (k < std::min(b.size(), j + 8) && b[k].position() != p.position()) ++k;
      if (k == std::min(b.size(), j + 8)) continue;
      same += b[k].reflectance == p.reflectance;
      j = k + 1;
    }
    EXPECT_GT(static_cast<double>(same), 0.995 * static_cast<double>(a.size())) << i;
  }
  EXPECT_GE(covered, 6);
}

// They stand where cars stand, at any distance, and come with labels of their own.
TEST(LookAlikes, AreInEveryStreet) {
  for (Look look : {Look::european, Look::american}) {
    int cars = 0, alikes = 0, far_cars = 0, far_alikes = 0;
    for (std::uint64_t index = 0; index < 20; ++index) {
      int here = 0;
      for (const auto& placed : generator::make_street(4, index, 1.73, look).placed) {
        const bool far_away = placed.box.bev.x > 35;
        if (placed.type == "Car") ++cars, far_cars += far_away;
        if (placed.kind == "look-alike") ++alikes, ++here, far_alikes += far_away;
      }
      EXPECT_GE(here, 1) << name_of(look) << ' ' << index;
    }
    EXPECT_GT(alikes, 0.55 * cars) << name_of(look);
    EXPECT_LT(alikes, 1.1 * cars) << name_of(look);
    EXPECT_GT(far_alikes, 0.5 * far_cars) << name_of(look);
  }
  Rig rig = test::small_rig();
  FrameTruth truth;
  const Frame frame = generate_frame(rig, 4, 0, &truth);
  int labelled = 0;
  for (std::size_t k = 0; k < frame.labels.size(); ++k) {
    if (frame.labels[k].type != "Misc") continue;
    ++labelled;
    const auto of_it = [&](std::uint32_t word) { return word >> 16 == k + 1; };
    EXPECT_TRUE(std::any_of(truth.returns.begin(), truth.returns.end(), of_it) ||
                std::count(truth.instance.data.begin(), truth.instance.data.end(), k + 1) > 0);
  }
  EXPECT_GE(labelled, 1);
}

// One car in ten carries something. The box stays the car's own, and so does its true shape.
TEST(RoofLoads, BelongToTheCarButNotToItsBox) {
  int loaded = 0;
  constexpr int count = 300;
  for (std::uint64_t i = 0; i < count; ++i) {
    RandomStream random(9, "roof load", i);
    const Actor car = i % 2 ? generator::american::make_car(random) : generator::make_car(random);
    const generator::Placed placed{"Car", {{0, 0, car.size.x(), car.size.y(), 0}, 0, car.size.z()}, car.kind};
    std::size_t on = 0;
    for (const Surface& s : car.surfaces) {
      if (!generator::on_roof(s, placed)) continue;
      ++on;
      const Eigen::AlignedBox3d box = bounds(s.mesh);
      EXPECT_GT(box.min().z(), 0.6 * car.size.z());  // nothing hangs below the roof
      EXPECT_LT(box.max().z(), car.size.z() + 0.6);
      EXPECT_LT(std::max(box.max().y(), -box.min().y()), 0.5 * car.size.y());
    }
    loaded += on > 0;
    EXPECT_FALSE(generator::on_roof(car.surfaces.front(), placed));
  }
  EXPECT_GT(loaded, 0.06 * count);
  EXPECT_LT(loaded, 0.15 * count);
  // A street's true shapes end at their boxes' tops.
  for (std::uint64_t index = 0; index < 6; ++index)
    for (const auto& vehicle : generator::true_vehicles(4, index, 1.73))
      EXPECT_LT(bounds(vehicle.mesh).max().z(), vehicle.box.bottom + vehicle.box.height + 0.02);
}

}  // namespace
}  // namespace mirage
