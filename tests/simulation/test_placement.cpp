#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <set>

#include "base/error.h"
#include "base/random.h"
#include "base/sizes.h"
#include "base/types.h"
#include "geometry/mesh.h"
#include "simulation/insertion.h"
#include "simulation/placement.h"
#include "simulation/sensor_pass.h"
#include "support/files.h"
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
  return placement_of(place, car(), {});
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

PlaceChoice choice(const std::string& text) {
  PlaceChoice place;
  set_from_text(text, place);
  return place;
}

/// Another car with its centre at (x, y) in the first one's frame.
Label other_at(double x, double y) {
  Label other = car().label;
  const Vec3d p = velo_from_box(other.box) * Vec3d(x, y, 0);
  other.box.bev.x = p.x(), other.box.bev.y = p.y();
  return other;
}

TEST(Placement, AFileFitsCarsOfAnyLength) {
  const PlaceChoice rack = choice("rear-rack");
  for (const double length : {2.5, 4.0, 12.0}) {
    Carrier host = car();
    host.label.box.bev.length = length;
    const Placement placement = placement_of(rack, host, std::array{host.label});
    const Vec3d p = velo_from_box(host.label.box).inverse() * placement.velo_from_adversary.translation();
    EXPECT_LT((p - Vec3d(-length / 2 + rack.at.x(), rack.at.y(), rack.at.z())).norm(), 1e-9);
    EXPECT_EQ(placement.support, Support::free);
    EXPECT_EQ(placement.left_out, LeftOut::no);
    EXPECT_TRUE(placement.grows_box);
  }
  PlaceChoice side = rack;
  side.in = PlaceChoice::In::left, side.at = Vec3d(0.5, 1, 0), side.yaw = 90;
  const Placement placement = placement_of(side, car(), {});
  const Transform vehicle_from_object =
      velo_from_box(car().label.box).inverse() * placement.velo_from_adversary;
  EXPECT_LT((vehicle_from_object.translation() - Vec3d(0.5, car().label.box.bev.width / 2 + 1, 0)).norm(),
            1e-9);
  EXPECT_NEAR(vehicle_from_object(1, 0), 1, 1e-12);
  side.in = PlaceChoice::In::roof, side.at = Vec3d(0.2, 0, 0.1);
  EXPECT_LT((placement_of(side, car(), {}).velo_from_adversary.translation() -
             car().velo_from_roof * Vec3d(0.2, 0, 0.1))
                .norm(),
            1e-9);
}

TEST(Placement, AFilesObjectNeedsRoom) {
  PlaceChoice ahead = choice("road-ahead");
  ahead.at = Vec3d(3, 0, 0);
  const double length = car().label.box.bev.length;
  const auto left_out = [&](const PlaceChoice& place, const Label& other) {
    const Placement placement = placement_of(place, car(), std::array{car().label, other});
    EXPECT_EQ(placement.targets.empty(), placement.left_out != LeftOut::no);
    return placement.left_out;
  };
  EXPECT_EQ(left_out(ahead, other_at(length + 3, 0)), LeftOut::no_room);
  EXPECT_EQ(left_out(ahead, other_at(length + 3.6, 0)), LeftOut::no);
  Label above = other_at(length + 3, 0);
  above.box.bottom += 5;
  EXPECT_EQ(left_out(ahead, above), LeftOut::no);
  PlaceChoice numbers = ahead;
  numbers.name.clear();
  EXPECT_EQ(left_out(numbers, other_at(length + 3, 0)), LeftOut::no);
  // Measured from the middle of its box, the host itself may overlap the object.
  ahead.in = PlaceChoice::In::vehicle;
  ahead.at = Vec3d(length / 2 + 0.2, 0, 0);
  EXPECT_EQ(left_out(ahead, other_at(30, 0)), LeftOut::no_room);
  ahead.at.x() += 0.4;
  EXPECT_EQ(left_out(ahead, other_at(30, 0)), LeftOut::no);
}

TEST(Placement, TheNeighbourIsTheVehicleNearestToTheObject) {
  const PlaceChoice kerb = choice("kerb");
  Label van = other_at(0, -4), dont_care = other_at(0, -3.8);
  van.type = "Van", dont_care.type = "DontCare";
  const std::vector<Label> labels = {other_at(9, 0), van, car().label, other_at(8, -1), dont_care};
  const Placement placement = placement_of(kerb, car(), labels);
  EXPECT_EQ(placement.neighbour, 3);
  ASSERT_EQ(placement.targets.size(), 1u);
  EXPECT_EQ(placement.targets[0].box.bev.x, labels[3].box.bev.x);
  const Placement alone = placement_of(kerb, car(), std::array{car().label, other_at(25, 0)});
  EXPECT_EQ(alone.left_out, LeftOut::no_neighbour);
  EXPECT_TRUE(alone.targets.empty());
  EXPECT_THAT(why_left_out(kerb, alone.left_out), testing::HasSubstr("12 m"));
}

TEST(Placement, AGrownBoxHoldsVehicleAndObject) {
  const Placement rack = placement_of(choice("rear-rack"), car(), {});
  const Mesh placed = place(grey_ellipsoid(Vec3d(0.4, 1.2, 0.9)), rack).mesh;
  const Box3 &box = car().label.box, grown = grown_box(box, placed);
  for (const Vec3d& v : placed.vertices) EXPECT_TRUE(contains(grown, v, 1e-9));
  for (const Vec3d& v : corners(box)) EXPECT_TRUE(contains(grown, v, 1e-9));
  EXPECT_NEAR(grown.bev.length, box.bev.length + 0.9, 1e-9);  // 0.5 m to its middle, and half of 0.8 m
  EXPECT_NEAR(grown.bev.width, 2.4, 0.02);
  EXPECT_NEAR(grown.height, 2.3, 0.02);
  EXPECT_EQ(grown.bottom, box.bottom);
  EXPECT_EQ(grown.bev.yaw, box.bev.yaw);
  Mesh more = placed;  // files may contain vertices that no face uses
  more.vertices.emplace_back(-50, 0, 9);
  EXPECT_NEAR(grown_box(box, more).bev.length, grown.bev.length, 1e-12);
  EXPECT_NEAR(grown_box(box, more).height, grown.height, 1e-12);
  const Box3 same = grown_box(box, {});
  EXPECT_NEAR(iou(same, box), 1, 1e-12);
}

TEST(Placement, TheObjectHasALabelOfItsOwn) {
  PlaceChoice nearer = choice("debris");
  nearer.at.x() = -2;  // otherwise the picture would end above it
  const Placement debris = placement_of(nearer, car(), {});
  EXPECT_EQ(debris.victim, Victim::object);
  EXPECT_TRUE(debris.targets.empty());
  EXPECT_EQ(debris.left_out, LeftOut::no);
  const Calibration calibration = test::make_world(1).prepared.frame.calibration;
  const Mesh placed = place(grey_ellipsoid(Vec3d(0.4, 0.3, 0.2)), debris).mesh;
  const Label own = own_label(debris, placed, calibration);
  EXPECT_EQ(own.type, "Misc");
  EXPECT_EQ(own.track, car().label.track);
  for (const Vec3d& v : placed.vertices) EXPECT_TRUE(contains(own.box, v, 1e-9));
  EXPECT_NEAR(own.box.bev.length, 0.8, 0.01);
  EXPECT_NEAR(own.box.bev.width, 0.6, 0.01);
  EXPECT_NEAR(own.box.height, 0.4, 0.01);
  EXPECT_NEAR(own.box.bottom, car().label.box.bottom, 1e-9);
  EXPECT_NEAR(own.box.bev.yaw, car().label.box.bev.yaw, 1e-9);
  EXPECT_GT(own.right, own.left);
  for (const Vec3d& v : placed.vertices) {
    const Vec3d seen = calibration.camera_from_velo * v;
    const double u = calibration.camera.cx + calibration.camera.fx * seen.x() / seen.z();
    EXPECT_GE(u, own.left - 1e-9);
    EXPECT_LE(u, own.right + 1e-9);
  }
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

// --quality: the values of the names, and that the user's values win.

namespace {

using testing::HasSubstr;

TEST(Quality, DefaultIsWhatTheSimulationHoldsByItself) {
  const SimulationSettings own;
  SimulationSettings settings;
  settings.raster.sigma = 1, settings.raster.gamma = 1, settings.raster.dist_eps = 0.3;
  settings.supersampling = 7, settings.reference = true, settings.exact_coverage = true;
  apply_quality("default", settings);
  EXPECT_EQ(settings.raster.sigma, own.raster.sigma);
  EXPECT_EQ(settings.raster.gamma, own.raster.gamma);
  EXPECT_EQ(settings.raster.dist_eps, own.raster.dist_eps);
  EXPECT_EQ(settings.supersampling, own.supersampling);
  EXPECT_EQ(settings.reference, own.reference);
  EXPECT_EQ(settings.exact_coverage, own.exact_coverage);
}

TEST(Quality, ThreeNamesInOrderOfTheirImage) {
  ASSERT_EQ(qualities().size(), 3u);
  EXPECT_STREQ(qualities()[0].name, "draft");
  EXPECT_STREQ(qualities()[1].name, "default");
  EXPECT_STREQ(qualities()[2].name, "exact");
  EXPECT_LT(qualities()[0].supersampling, qualities()[1].supersampling);
  EXPECT_FALSE(qualities()[1].exact);
  EXPECT_TRUE(qualities()[2].exact);
}

TEST(Quality, WhatTheUserGaveStays) {
  const Quality& draft = quality_of("draft");
  for (const std::string given : {"--sigma", "--gamma", "--supersampling"}) {
    SimulationSettings settings;
    settings.raster.sigma = 3e-6, settings.raster.gamma = 0.05, settings.supersampling = 7;
    apply_quality("draft", settings, [&](const char* option) { return option == given; });
    EXPECT_EQ(settings.raster.sigma, given == "--sigma" ? 3e-6 : draft.sigma);
    EXPECT_EQ(settings.raster.gamma, given == "--gamma" ? 0.05 : draft.gamma);
    EXPECT_EQ(settings.supersampling, given == "--supersampling" ? 7 : draft.supersampling);
    EXPECT_EQ(settings.raster.dist_eps, draft.dist_eps);
  }
}

TEST(Quality, ExactAreasHaveNoSoftnessToGive) {
  for (const std::string given : {"--sigma", "--gamma", "--supersampling"}) {
    SimulationSettings settings;
    const std::string text = test::error_text<InputError>(
        [&] { apply_quality("exact", settings, [&](const char* option) { return option == given; }); });
    EXPECT_THAT(text, HasSubstr(given));
    EXPECT_THAT(text, HasSubstr("exact"));
    EXPECT_FALSE(settings.exact_coverage);
  }
}

TEST(Quality, NothingElseChanges) {
  SimulationSettings settings;
  settings.lidar_reflectivity = 0.3, settings.occlusion_margin = 0.1, settings.grazing_cosine = 0.2;
  settings.raster.edge_on_altitude = 1e-5;
  apply_quality("draft", settings);
  EXPECT_EQ(settings.lidar_reflectivity, 0.3);
  EXPECT_EQ(settings.occlusion_margin, 0.1);
  EXPECT_EQ(settings.grazing_cosine, 0.2);
  EXPECT_EQ(settings.raster.edge_on_altitude, 1e-5);
  const SimulationSettings before = settings;
  apply_quality("", settings);
  EXPECT_EQ(settings.supersampling, before.supersampling);
}

TEST(Quality, AnotherWordIsAnErrorThatNamesTheThree) {
  SimulationSettings settings;
  const std::string text = test::error_text<InputError>([&] { apply_quality("best", settings); });
  EXPECT_THAT(text, testing::StartsWith("quality: best: "));
  for (const char* name : {"best", "draft", "default", "exact"}) EXPECT_THAT(text, HasSubstr(name));
}

using test::make_world;

/// Values that float represents exactly, in float and in double.
template <class S>
std::vector<S> upstream_values(std::size_t count) {
  RandomStream random(7, "upstream");
  std::vector<S> values(count);
  for (S& value : values) value = static_cast<S>(static_cast<float>(random.uniform(-1, 1)));
  return values;
}

template <class S>
AdversaryGradient pulled_back(const Simulated& s) {
  const auto image = upstream_values<S>(s.image.data.size()), points = upstream_values<S>(4 * s.sweep.size());
  return simulate_vjp(s,
                      Upstream{image.data(), s.image.width, s.image.height, {points.data(), s.sweep.size()}});
}

TEST(Upstream, TheCallersMemoryInFloatAndInDouble) {
  const test::World world = make_world(1);
  for (const bool reference : {false, true}) {
    SimulationSettings settings;
    settings.reference = reference;
    const Simulated s = simulate(world.prepared, world.placement, world.adversary, settings);
    ImageF d_image(s.image.width, s.image.height, 3);
    d_image.data = upstream_values<float>(d_image.data.size());
    const auto flat = upstream_values<float>(4 * s.sweep.size());
    std::vector<std::array<float, 4>> d_points(s.sweep.size());
    std::copy(flat.begin(), flat.end(), d_points.front().data());
    const AdversaryGradient own = simulate_vjp(s, d_image, d_points);
    for (const AdversaryGradient& gradient : {pulled_back<float>(s), pulled_back<double>(s)}) {
      EXPECT_EQ(gradient.vertices, own.vertices);
      EXPECT_EQ(gradient.texels, own.texels);
    }
  }
}

TEST(Upstream, TheReturnsInDoubleAreTheSweeps) {
  const test::World world = make_world(2);
  const Simulated s = simulate(world.prepared, world.placement, world.adversary);
  const auto exact = object_returns(s);
  ASSERT_GT(exact.size(), 20u);
  ASSERT_EQ(exact.size(), as_size(s.adversary_points));
  for (std::size_t i = 0; i < exact.size(); ++i) {
    const LidarPoint& point = s.sweep[s.sweep.size() - exact.size() + i];
    EXPECT_EQ(point.x, static_cast<float>(exact[i][0]));
    EXPECT_EQ(point.reflectance, static_cast<float>(exact[i][3]));
  }
}

}  // namespace
}  // namespace mirage
