#include <gtest/gtest.h>

#include "base/angles.h"
#include "simulation/placement.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

const Carrier& car() {
  static const Carrier carrier = *test::make_world(1).placement.carrier;
  return carrier;
}

Placement at(const std::string& text) {
  PlaceChoice place;
  set_from_text(text, place);
  return placement_of(place, car());
}

TEST(Placement, OfTheRoofIsTheCarriers) {
  const Placement roof = at("roof");
  EXPECT_EQ(roof.velo_from_adversary.matrix(), car().velo_from_roof.matrix());
  EXPECT_EQ(roof.support, Support::roof);
  ASSERT_EQ(roof.targets.size(), 1u);
  EXPECT_EQ(roof.targets[0].box.bev.x, car().label.box.bev.x);
}

TEST(Placement, IsInTheVehiclesFrameOrInTheWorlds) {
  const BevBox& box = car().label.box.bev;
  const Transform beside = at("1,-2,0.25,90").velo_from_adversary,
                  world = at("world:1,-2,0.25,90").velo_from_adversary;
  const double c = std::cos(box.yaw), s = std::sin(box.yaw);
  const Vec3d expected(box.x + c + 2 * s, box.y + s - 2 * c, car().label.box.bottom + 0.25);
  EXPECT_LT((beside.translation() - expected).norm(), 1e-12);
  EXPECT_NEAR(std::atan2(beside(1, 0), beside(0, 0)), box.yaw + 90 * kDegree, 1e-12);
  EXPECT_LT((world.translation() - Vec3d(1, -2, 0.25)).norm(), 1e-12);
  EXPECT_NEAR(std::atan2(world(1, 0), world(0, 0)), 90 * kDegree, 1e-12);
}

TEST(Placement, StandsOnTheCarAboveItsWaistAndFreeElsewhere) {
  EXPECT_EQ(at("0,0,1.5,0").support, Support::roof);
  EXPECT_EQ(at("1.8,0,0.9,0").support, Support::roof);  // on the bonnet
  EXPECT_EQ(at("1.8,0,0.8,0").support, Support::free);  // in it
  EXPECT_EQ(at("2.1,0,1.5,0").support, Support::free);
  EXPECT_EQ(at("0,0.9,1.5,0").support, Support::free);
  EXPECT_EQ(at("world:12,1.5,0,0").support, Support::roof);
  EXPECT_EQ(at("world:12,1.5,-1.7,0").support, Support::free);
}

/// The car stands between the object and the sun.
TEST(Placement, ACarBesideTheObjectShadesIt) {
  test::World world = test::make_world(2);
  world.prepared.frame.lighting.to_sun_velo = velo_from_box(car().label.box).linear() * Vec3d(0, 0.98, 0.2);
  SimulationSettings settings;
  settings.light = LightModel::visible;
  Placement beside = at("0,-1.7,0,0"), alone = beside;
  alone.carrier.reset();
  const auto brightness = [&](const Placement& placement) {
    const Simulated s = simulate(world.prepared, placement, world.adversary, settings);
    double sum = 0;
    for (int v = 0; v < s.rgba.height; ++v)
      for (int u = 0; u < s.rgba.width; ++u)
        if (s.rgba.at(u, v, 3) > 0.99) sum += s.rgba.at(u, v, 0);
    return sum / s.adversary_pixels;
  };
  EXPECT_LT(brightness(beside), 0.8 * brightness(alone));
}

}  // namespace
}  // namespace mirage
