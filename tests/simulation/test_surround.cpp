// One object in several cameras: its pixels and its occlusion in each, and the gradient through all.
#include <gtest/gtest.h>

#include "base/random.h"
#include "simulation/camera_pass.h"
#include "simulation/insertion.h"
#include "simulation/sensor_pass.h"
#include "support/gradient_check.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::make_world;
using test::World;

/// The first camera at another pose: it looks along `yaw` (rad, from forward) from `at` (m, `velo`).
SideCamera camera_at(const std::string& name, const Calibration& like, double yaw, const Vec3d& at,
                     std::function<ImageF()> picture) {
  SideCamera camera{name, like, Lazy<ImageF>(std::move(picture))};
  Transform velo_from_turned = Transform::Identity();
  velo_from_turned.linear() = Eigen::AngleAxisd(yaw, Vec3d::UnitZ()).toRotationMatrix();
  velo_from_turned.translation() = at;
  camera.calibration.camera_from_velo = like.camera_from_velo * velo_from_turned.inverse();
  return camera;
}

ImageF grey(float value) {
  return {207, 63, 3, value};
}

/// The world's car. The first camera is turned to the right, and its picture cuts off the car's left part.
/// LEFT sees that part, SIDE the whole car from its left side, and BACK nothing.
World surround(const Sweep& sweep = {}) {
  World world = make_world(1);
  Frame frame = world.prepared.frame;
  frame.calibration.camera.cx = 103;
  frame.calibration.camera_from_velo.translation().setZero();  // both turn about one point
  const double seam = std::atan2(103.5, 120.3);                // from the picture's middle to its edges
  const Vec3d roof = world.placement.velo_from_adversary.translation();
  const double to_roof = std::atan2(roof.y(), roof.x());
  const Calibration ahead = frame.calibration;
  frame.calibration = camera_at("", ahead, to_roof - seam, Vec3d::Zero(), nullptr).calibration;
  frame.camera = "FRONT";
  frame.sweep = sweep;
  frame.others = {
      camera_at("BACK", ahead, M_PI, Vec3d::Zero(),
                []() -> ImageF { throw std::logic_error("a picture that shows nothing of it was read"); }),
      camera_at("LEFT", ahead, to_roof + seam, Vec3d::Zero(), [] { return grey(0.3f); }),
      camera_at("SIDE", ahead, -M_PI / 2, Vec3d(roof.x(), roof.y() + 9, 0), [] { return grey(0.6f); })};
  world.prepared = prepare(frame, world.prepared.lidar);
  return world;
}

TEST(Surround, ACarOnTheSeamIsInBothCamerasAndInNoOther) {
  const World world = surround();
  const Simulated seen = simulate(world.prepared, world.placement, world.adversary);
  ASSERT_EQ(seen.others.size(), 3u);
  const CameraSight &back = seen.others[0], &left = seen.others[1], &side = seen.others[2];
  EXPECT_GT(seen.adversary_pixels, 20);
  EXPECT_GT(left.adversary_pixels, 20);
  EXPECT_TRUE(back.image.empty());
  EXPECT_EQ(back.adversary_pixels, 0);
  // Each cuts off about one half, and together they show everything; the side camera has all of it.
  EXPECT_NEAR(seen.visible_share + left.visible_share, 1, 0.1);
  EXPECT_GT(std::min(seen.visible_share, left.visible_share), 0.3);
  EXPECT_EQ(seen.rect.u0, 0);
  EXPECT_EQ(left.rect.u1, 207);
  EXPECT_GT(side.visible_share, 0.999);
  EXPECT_EQ(seen.best_share(), side.visible_share);
  // Over each camera's own picture.
  EXPECT_EQ(left.image.at(0, 0, 0), 0.3f);
  EXPECT_EQ(side.image.at(0, 0, 0), 0.6f);
}

// A single camera gives the same, to the bit, and every camera draws what it would draw as the first.
TEST(Surround, EachCameraDrawsAsItWouldAlone) {
  const World world = surround();
  const Simulated all = simulate(world.prepared, world.placement, world.adversary);
  for (std::size_t k = 0; k < world.prepared.frame.cameras(); ++k) {
    if (k == 1) continue;  // BACK
    Frame alone = world.prepared.frame;
    alone.image = world.prepared.frame.image_of(k);
    alone.calibration = world.prepared.frame.calibration_of(k);
    alone.others.clear();
    const Simulated one = simulate(prepare(alone, world.prepared.lidar), world.placement, world.adversary);
    EXPECT_EQ(one.image.data, all.sight(k).image.data) << k;
    EXPECT_EQ(one.rgba.data, all.sight(k).rgba.data) << k;
    EXPECT_EQ(one.visible_share, all.sight(k).visible_share) << k;
  }
}

// A wall of returns between the car and the side camera: LEFT and the first camera see past it.
TEST(Surround, WhatHidesItIsEachCamerasOwnDepth) {
  const Vec3d roof = surround().placement.velo_from_adversary.translation();
  Sweep wall;
  for (double x = -3; x <= 3; x += 0.1)
    for (double z = -2; z <= 2; z += 0.1)
      wall.push_back({static_cast<float>(roof.x() + x), static_cast<float>(roof.y() + 5),
                      static_cast<float>(roof.z() + z), 0.5f});
  const World open = surround(), walled = surround(wall);
  const Simulated before = simulate(open.prepared, open.placement, open.adversary),
                  after = simulate(walled.prepared, walled.placement, walled.adversary);
  EXPECT_EQ(after.others[2].adversary_pixels, 0);
  EXPECT_LT(after.others[2].visible_share, 1e-6);
  EXPECT_EQ(after.others[2].image.data, grey(0.6f).data);
  EXPECT_EQ(after.visible_share, before.visible_share);
  EXPECT_EQ(after.others[1].rgba.data, before.others[1].rgba.data);
}

// For cameras that may_see leaves out, the rasteriser would not have drawn any pixel, wherever the object is.
TEST(Surround, NoCameraIsLeftOutThatSeesIt) {
  const World world = surround();
  RandomStream random(7, "placements around");
  int seen = 0, left_out = 0;
  for (int i = 0; i < 300; ++i) {
    Placement placement = world.placement;
    placement.velo_from_adversary.translation() =
        Vec3d{random.uniform(-20, 20), random.uniform(-20, 20), random.uniform(-3, 3)};
    const Mesh placed = place(world.adversary, placement).mesh;
    for (const SimulationSettings& settings : {SimulationSettings(), test::smooth_settings()}) {
      CameraSight sight;
      draw_in_camera(world.prepared, placement, {placed, world.adversary.atlas}, settings, sight);
      const bool may = may_see(world.prepared.frame.calibration, placed, settings);
      ASSERT_TRUE(may || sight.rect.empty()) << i;
      seen += !sight.rect.empty();
      left_out += !may;
    }
  }
  EXPECT_GT(seen, 50);
  EXPECT_GT(left_out, 200);
}

TEST(Surround, TheGradientComesBackThroughAllCameras) {
  const World world = surround();
  const SimulationSettings settings = test::smooth_settings();
  const Simulated at = simulate(world.prepared, world.placement, world.adversary, settings);
  RandomStream random(2, "upstream");
  std::vector<Image<double>> d_images;
  for (std::size_t k = 0; k < 4; ++k) {
    d_images.emplace_back(207, 63, 3);
    for (double& value : d_images.back().data) value = random.uniform(-1, 1);
  }
  const auto loss = [&](const TexturedMesh& adversary) {
    const Simulated s = simulate(world.prepared, world.placement, adversary, settings);
    double sum = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      if (k == 1) continue;  // BACK
      const CameraSight& sight = s.sight(k);
      for (int v = sight.rect.v0; v < sight.rect.v1; ++v)
        for (int u = sight.rect.u0; u < sight.rect.u1; ++u)
          for (int c = 0; c < 3; ++c)  // relative to the background: the window's size doesn't matter
            sum += d_images[k].at(u, v, c) * (sight.rgba.at(u - sight.rect.u0, v - sight.rect.v0, c) -
                                              world.prepared.frame.image_of(k).at(u, v, c));
    }
    return sum;
  };
  const std::vector<GradientView> others = {{}, d_images[2].data.data(), d_images[3].data.data()};
  Upstream upstream{d_images[0].data.data(), 207, 63};
  upstream.others = others;
  const AdversaryGradient gradient = simulate_vjp(at, upstream);
  const auto moved = [&](const std::vector<double>& x) {
    TexturedMesh mesh = world.adversary;
    for (std::size_t i = 0; i < mesh.mesh.vertices.size(); ++i)
      mesh.mesh.vertices[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
    return loss(mesh);
  };
  const auto painted = [&](const std::vector<double>& x) {
    TexturedMesh mesh = world.adversary;
    for (std::size_t i = 0; i < mesh.atlas.texels.size(); ++i)
      mesh.atlas.texels[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
    return loss(mesh);
  };
  const auto some = [](std::size_t i) { return i % 5 == 0; };  // of all axes and colours
  const auto vertices = test::check_gradient(moved, test::flat(world.adversary.mesh.vertices),
                                             test::flat(gradient.vertices), 1e-7, 1e-4, 1.0, some);
  const auto texels = test::check_gradient(painted, test::flat(world.adversary.atlas.texels),
                                           test::flat(gradient.texels), 1e-4, 1e-6, 1e-2, some);
  std::printf("three cameras: vertices %d components, worst %.1e; texels %d, worst %.1e\n", vertices.checked,
              vertices.worst, texels.checked, texels.worst);
  // Each camera contributes to the gradient: without one of them it is different.
  for (std::size_t without = 1; without < 3; ++without) {
    std::vector<GradientView> fewer = others;
    fewer[without] = {};
    upstream.others = fewer;
    EXPECT_GT((simulate_vjp(at, upstream).vertices[0] - gradient.vertices[0]).norm() +
                  (simulate_vjp(at, upstream).texels[0] - gradient.texels[0]).norm(),
              0);
  }
}

}  // namespace
}  // namespace mirage
