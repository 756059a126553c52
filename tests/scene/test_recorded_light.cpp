#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/error.h"
#include "base/random.h"
#include "base/types.h"
#include "scene/data/read_frames.h"
#include "scene/recorded_light.h"
#include "sensors/lighting.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

TEST(Sun, PositionIsThePublishedOneOfTheSolarPositionAlgorithm) {
  // Reda & Andreas, NREL/TP-560-34302, example of appendix A.5: 12:30:30 at UTC − 7 h, zenith 50.11162°,
  // azimuth 194.34024°. The example is at 1830 m with 820 mbar and 11 °C, and includes parallax.
  const SunPosition sun = sun_position(39.742476 * kDegree, -105.1786 * kDegree, {2003, 10, 17, 19, 30, 30});
  EXPECT_NEAR(sun.azimuth / kDegree, 194.34024, 0.002);
  EXPECT_NEAR(90 - sun.elevation / kDegree, 50.11162, 0.01);
}

TEST(Sun, PositionAtNoonAndOnBothHemispheres) {
  // Equinox of 2024: 20 March 03:06:21 UTC, when the declination is 0; nine hours later it is 0.148° (the
  // sun moves by 0.9932° a day along an ecliptic inclined by 23.44°). The equation of time is −7.4 minutes,
  // so noon at longitude 0 comes at 12:07.4. Without precession the declination would be 0.135° less.
  EXPECT_NEAR(sun_position(0, 0, {2024, 3, 20, 12, 7, 24}).elevation / kDegree, 90 - 0.148, 0.01);
  // Morning in the east, evening in the west; at noon the sun is south of Karlsruhe and north of Sydney.
  const double north = 49 * kDegree, east = 8.4 * kDegree;
  EXPECT_NEAR(sun_position(north, east, {2011, 9, 26, 6, 0, 0}).azimuth / kDegree, 97, 5);
  EXPECT_NEAR(sun_position(north, east, {2011, 9, 26, 17, 0, 0}).azimuth / kDegree, 265, 5);
  const SunPosition noon = sun_position(north, east, {2011, 9, 26, 11, 17, 30});
  EXPECT_NEAR(noon.azimuth / kDegree, 180, 1);
  EXPECT_NEAR(noon.elevation / kDegree, 90 - 49 - 1.3,
              0.5);  // declination −1.3° three days after the equinox
  const double azimuth = sun_position(-33.9 * kDegree, 151.2 * kDegree, {2011, 9, 26, 1, 45, 0}).azimuth;
  EXPECT_GT(std::cos(azimuth), 0.99);
}

TEST(Sun, TheFramesOwnLightingStaysUntouched) {
  Frame frame;
  frame.lighting.to_sun_velo = Vec3d(0.3, -0.8, 0.4).normalized();
  const Lighting lighting = with_sun(frame, parse_sun("frame"));
  EXPECT_EQ(lighting.to_sun_velo, frame.lighting.to_sun_velo);
  EXPECT_EQ(lighting.sun, frame.lighting.sun);
}

TEST(Sun, AGivenDirectionIsCounterClockwiseFromForward) {
  Frame frame;
  frame.lighting.sun = Vec3d(3, 2, 1);
  const auto direction = [&](const char* word) { return with_sun(frame, parse_sun(word)).to_sun_velo; };
  const double half = std::sqrt(0.5), cos60 = 0.5, sin60 = std::sqrt(0.75);
  EXPECT_NEAR((direction("0,45") - Vec3d(half, 0, half)).norm(), 0, 1e-12);
  EXPECT_NEAR((direction("90,60") - Vec3d(0, cos60, sin60)).norm(), 0, 1e-12);  // from the left
  EXPECT_NEAR((direction("-90,60") - Vec3d(0, -cos60, sin60)).norm(), 0, 1e-12);
  EXPECT_NEAR((direction("270, 60") - direction("-90,60")).norm(), 0, 1e-12);
  EXPECT_NEAR((direction("+12.5,90") - Vec3d(0, 0, 1)).norm(), 0, 1e-12);
  const Lighting lit = with_sun(frame, parse_sun("0,45"));
  EXPECT_EQ(lit.sun, frame.lighting.sun);
  EXPECT_EQ(lit.hemisphere, frame.lighting.hemisphere);
}

TEST(Sun, PlaceAndTimeAreTurnedIntoTheVehiclesFrame) {
  // NREL's example: the sun is 14.34° west of south. Facing east (heading 0), south is to the right.
  const auto azimuth = [](const std::string& heading) {
    const Vec3d to_sun = *parse_sun("39.742476,-105.1786,2003-10-17T19:30:30Z," + heading).to_sun_velo;
    EXPECT_NEAR(std::asin(to_sun.z()) / kDegree, 90 - 50.11162, 0.02);
    EXPECT_NEAR(to_sun.norm(), 1, 1e-12);
    return std::atan2(to_sun.y(), to_sun.x()) / kDegree;
  };
  EXPECT_NEAR(azimuth("0"), -90 - 14.34, 0.002);
  EXPECT_NEAR(azimuth("-90"), -14.34, 0.01);  // facing south
  EXPECT_NEAR(azimuth("180"), 90 - 14.34, 0.01);
  EXPECT_NEAR(azimuth("255.66"), 0, 0.01);  // facing the sun
  EXPECT_EQ(parse_sun("39.7,-105,2003-10-17T19:30:30.000Z,0").to_sun_velo,
            parse_sun("39.7,-105,2003-10-17T19:30:30Z,0").to_sun_velo);
}

/// Ground in a camera with three cars and the shadows of their boxes under a sun: flat, noisy asphalt and
/// returns on it. `shade` is the shadows' share of the light.
Frame street(const Vec3d& to_sun, double shade) {
  Frame frame;
  frame.id = "000000";
  PinholeCamera& camera = frame.calibration.camera;
  camera = {360, 360, 310, 86, 621, 188};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  const double ground = -1.7;
  for (const Vec3d& at : {Vec3d(9, 4, 0.1), Vec3d(13, -4, -0.1), Vec3d(17, 3, 0.4)}) {
    Label label;
    label.type = "Car";
    label.box = {BevBox{at.x(), at.y(), 4.2, 1.8, at.z()}, ground, 1.5};
    frame.labels.push_back(label);
  }
  const auto shaded = [&](const Vec3d& p) {
    for (const Label& label : frame.labels)
      for (double t = 0; t < 8; t += 0.05) {
        const Vec3d q = p + t * to_sun;
        const BevBox& box = label.box.bev;
        const double dx = q.x() - box.x, dy = q.y() - box.y, c = std::cos(box.yaw), s = std::sin(box.yaw);
        if (q.z() - ground < label.box.height && std::abs(c * dx + s * dy) < box.length / 2 &&
            std::abs(c * dy - s * dx) < box.width / 2)
          return true;
      }
    return false;
  };
  RandomStream random(3, "street", 0);
  frame.image = ImageF(camera.width, camera.height, 3);
  const Transform velo_from_camera = frame.calibration.camera_from_velo.inverse();
  for (int v = 0; v < camera.height; ++v)
    for (int u = 0; u < camera.width; ++u) {
      const Vec3d way = velo_from_camera.linear() * camera.unproject(u, v, 1);
      const double depth = way.z() < 0 ? ground / way.z() : 0;
      double light = 0.3 * std::exp(0.15 * random.normal());
      if (depth > 0 && depth < 30 && shaded(depth * way)) light *= shade;
      for (int k = 0; k < 3; ++k) frame.image.at(u, v, k) = static_cast<float>(light);
    }
  for (double x = 4; x < 24; x += 0.25)
    for (double y = -9; y < 9; y += 0.1)
      frame.sweep.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(ground), 0.3f});
  return frame;
}

TEST(Sun, ShadowsInThePhotographTellWhereItStands) {
  for (const double azimuth : {-150.0, -60.0, 25.0, 100.0}) {
    const Frame frame = street(unit_vector(azimuth * kDegree, 30 * kDegree), 0.35);
    const std::optional<Vec3d> found = sun_from_shadows(frame);
    ASSERT_TRUE(found) << azimuth;
    const double error = std::atan2(found->y(), found->x()) / kDegree - azimuth;
    EXPECT_LE(std::abs(std::remainder(error, 360)), 15) << azimuth;
    EXPECT_NEAR(std::asin(found->z()) / kDegree, 30, 12) << azimuth;
    const Lighting lighting = with_sun(frame, parse_sun("photo"));
    EXPECT_EQ(lighting.to_sun_velo, *found);
    EXPECT_EQ(lighting.sun, frame.lighting.sun);
  }
}

TEST(Sun, APhotographWithoutShadowsKeepsTheFramesLighting) {
  for (Frame frame : {street(Vec3d::UnitX(), 1), Frame{}}) {
    EXPECT_FALSE(sun_from_shadows(frame));
    EXPECT_EQ(with_sun(frame, parse_sun("photo")).to_sun_velo, frame.lighting.to_sun_velo);
  }
  // Shadows, but neither labels nor returns from which their casters could be found.
  Frame frame = street(unit_vector(1, 0.5), 0.35);
  const Sweep sweep = std::exchange(frame.sweep, {});
  EXPECT_FALSE(sun_from_shadows(frame));
  frame.sweep = sweep;
  for (LidarPoint& point : frame.sweep) point.x = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(sun_from_shadows(frame));
  frame.sweep = sweep;
  for (Label& label : frame.labels) label.type = "DontCare";
  EXPECT_FALSE(sun_from_shadows(frame));
}

TEST(Sun, WhatIsNotASunIsOneLineWithTheFix) {
  for (const auto& [word, part] : std::vector<std::pair<std::string, std::string>>{
           {"noon", "use frame"},
           {"", "use frame"},
           {"1,2,3", "use frame"},
           {"left,30", "azimuth \"left\" is not a number"},
           {"30,", "elevation \"\" is not a number"},
           {"30,4x", "elevation \"4x\""},
           {"nan,30", "azimuth"},
           {"30,inf", "elevation"},
           {"400,30", "azimuth 400 is out of range"},
           {"30,91", "elevation 91 is out of range"},
           {"30,-5", "elevation -5 is out of range"},
           {"30,0", "over 0"},
           {"91,8,2011-09-26T12:00:00Z,0", "latitude 91"},
           {"49,181,2011-09-26T12:00:00Z,0", "longitude 181"},
           {"49,8,2011-09-26 12:00:00,0", "YYYY-MM-DDTHH:MM:SSZ"},
           {"49,8,2011-09-26T12:00:00,0", "YYYY-MM-DDTHH:MM:SSZ"},
           {"49,8,2011-09-26T12:00:00+2Z,0", "YYYY-MM-DDTHH:MM:SSZ"},
           {"49,8,2011-02-29T12:00:00Z,0", "does not exist"},
           {"49,8,2011-09-26T24:00:00Z,0", "does not exist"},
           {"49,8,2011-09-26T12:00:00Z,north", "heading \"north\""},
           {"49,8.4,2011-09-26T23:30:00Z,0", "below the horizon"}}) {
    const std::string text = error_text<InputError>([&] { parse_sun(word); });
    EXPECT_THAT(text, HasSubstr("sun: "));
    EXPECT_THAT(text, HasSubstr(part)) << word;
    EXPECT_EQ(text.find('\n'), std::string::npos);
  }
}

}  // namespace

// The light of recorded frames, estimated from the road in the photograph.

namespace {

/// A level road of the given radiance under a fixed sky.
Frame street(const Vec3d& road) {
  Frame frame;
  frame.calibration.camera = {144, 144, 122, 35, 248, 75};
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.calibration.camera_from_velo.linear() = axes;
  frame.image = ImageF(248, 75, 3, 0.9f);
  for (int v = 36; v < 75; ++v)
    for (int u = 0; u < 248; ++u)
      for (int c = 0; c < 3; ++c) frame.image.at(u, v, c) = static_cast<float>(road[c]);
  for (double x = 4; x < 30; x += 0.2)
    for (double y = -4; y <= 4; y += 0.2) frame.sweep.push_back({float(x), float(y), -1.7f, 0.2f});
  return frame;
}

Vec3d level_asphalt(const Lighting& light) {
  return kRoadAlbedo * shade(Vec3d::UnitZ(), light);
}

TEST(RoadExposure, LevelAsphaltIsAsBrightAsInThePhotograph) {
  for (const Vec3d& road : {Vec3d(0.21, 0.2, 0.19), Vec3d(0.08, 0.09, 0.1), Vec3d(0.35, 0.35, 0.35)}) {
    const Frame frame = street(road);
    const Lighting light = with_road_exposure(frame);
    EXPECT_LT((level_asphalt(light) - road).norm(), 1e-6);
    EXPECT_EQ(light.to_sun_velo, frame.lighting.to_sun_velo);
    EXPECT_NEAR(light.sun[0] / light.ambient[0], frame.lighting.sun[0] / frame.lighting.ambient[0], 1e-12);
  }
}

TEST(RoadExposure, CarsOnTheRoadAreNotTheRoad) {
  const Vec3d road(0.2, 0.2, 0.2);
  Frame frame = street(road);
  // A white car stands in the corridor and hides two thirds of it; its returns outnumber the road's.
  Label car;
  car.type = "Car";
  car.box = {{12, 0, 10, 2.5, 0}, -1.7, 1.5};
  frame.labels = {car};
  std::erase_if(frame.sweep, [](const LidarPoint& p) { return p.x > 7 && std::abs(p.y) < 2; });  // behind it
  RandomStream random(1, "returns of a car");
  for (int i = 0; i < 5000; ++i)
    frame.sweep.push_back({float(random.uniform(7, 17)), float(random.uniform(-1.2, 1.2)),
                           float(random.uniform(-1.6, -0.3)), 0.3f});
  for (int v = 36; v < 60; ++v)
    for (int u = 100; u < 145; ++u)
      for (int c = 0; c < 3; ++c) frame.image.at(u, v, c) = 0.95f;
  EXPECT_LT((level_asphalt(with_road_exposure(frame)) - road).norm(), 1e-6);
}

TEST(RoadExposure, StaysWhereTheRoadIsNotSeenAndWithinBounds) {
  Frame frame = street(Vec3d(0.2, 0.2, 0.2));
  const Lighting own = frame.lighting;
  frame.sweep.resize(20);
  EXPECT_FALSE(road_radiance(frame));
  EXPECT_EQ(with_road_exposure(frame).sun, own.sun);
  frame.sweep.clear();
  EXPECT_EQ(with_road_exposure(frame).ambient, own.ambient);
  // A black picture, and a picture of a lamp.
  EXPECT_NEAR(with_road_exposure(street(Vec3d::Zero())).sun[0], own.sun[0] / 2, 1e-12);
  EXPECT_NEAR(with_road_exposure(street(Vec3d::Constant(1e3))).sun[0], own.sun[0] * 3, 1e-12);
}

TEST(RoadExposureRealFrames, KittiIsBrighterThanTheDefaultLight) {
  MIRAGE_NEED_REAL_FRAMES();
  std::vector<double> gains, roads;
  const auto ids = list_frames(test::real_frames());
  for (const std::string& id : ids) {
    const Frame frame = read_frame(test::real_frames(), id);
    if (const auto road = road_radiance(frame)) {
      roads.push_back((*road)[1]);
      gains.push_back(frame.lighting.sun[1] / Lighting().sun[1]);
    }
  }
  ASSERT_GE(gains.size(), ids.size() * 3 / 4);
  std::sort(gains.begin(), gains.end());
  std::sort(roads.begin(), roads.end());
  std::printf("%zu of %zu frames: road %.3f (%.3f to %.3f), gain %.2f (%.2f to %.2f)\n", gains.size(),
              ids.size(), roads[roads.size() / 2], roads.front(), roads.back(), gains[gains.size() / 2],
              gains.front(), gains.back());
  EXPECT_GT(gains[gains.size() / 2], 1);
  EXPECT_LT(gains[gains.size() / 2], 4);
}

}  // namespace
}  // namespace mirage
