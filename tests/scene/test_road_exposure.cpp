// The light of recorded frames by the road in the photograph.
#include <gtest/gtest.h>

#include <algorithm>

#include "base/random.h"
#include "scene/data/read_frames.h"
#include "scene/light_surroundings.h"
#include "scene/road_exposure.h"
#include "sensors/shading.h"
#include "support/files.h"

namespace mirage {
namespace {

/// A level road of the given radiance under a sky of another.
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
  return kRoadAlbedo * shade<double>(Vec3d::UnitZ(), light);
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
  // A black picture, and one of a lamp.
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
