#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/camera.h"
#include "sensors/lidar_sweep.h"
#include "support/files.h"

namespace mirage {
namespace {

Image<double> random_image(int width, int height, const char* purpose) {
  Image<double> image(width, height, 4);
  RandomStream random(3, purpose);
  for (double& value : image.data) value = random.uniform(-1, 1);
  return image;
}

double dot(const Image<double>& a, const Image<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += a.data[i] * b.data[i];
  return sum;
}

TEST(CameraEffects, WordsSayWhichAndRefuseOthers) {
  EXPECT_FALSE(parse_camera_effects("ideal").any());
  const CameraEffects unit = parse_camera_effects("unit"), both = parse_camera_effects("noise,blur");
  EXPECT_EQ(unit.blur_sigma, both.blur_sigma);
  EXPECT_EQ(unit.shot, both.shot);
  EXPECT_EQ(unit.read_sigma, both.read_sigma);
  EXPECT_TRUE(unit.noisy());
  EXPECT_FALSE(parse_camera_effects("blur").noisy());
  EXPECT_EQ(parse_camera_effects("noise").blur_sigma, 0);
  for (const char* bad : {"", "fog", ",blur", "blur,fog", "unit,noise", "ideal,blur"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_camera_effects(bad); }),
                testing::StartsWith("camera_effects: "))
        << bad;
}

TEST(CameraEffects, SofteningKeepsLevelsAndItsTransposeIsOne) {
  for (const auto& [width, height] : {std::pair(9, 7), std::pair(1, 1), std::pair(2, 5), std::pair(1, 4)})
    for (const double sigma : {1e-200, 0.3, kLensBlur, 1.0}) {
      Image<double> flat(width, height, 3, 0.25);
      soften(flat, sigma);
      for (const double value : flat.data) EXPECT_NEAR(value, 0.25, 1e-15);
      const Image<double> x = random_image(width, height, "x"), y = random_image(width, height, "y");
      Image<double> ax = x, aty = y;
      soften(ax, sigma);
      soften_vjp(aty, sigma);
      EXPECT_NEAR(dot(ax, y), dot(x, aty), 1e-13) << width << "x" << height << " " << sigma;
    }
}

TEST(CameraEffects, AnImpulseSpreadsAsTheGaussianSays) {
  Image<double> image(9, 9, 1);
  image.at(4, 4) = 1;
  soften(image, kLensBlur);
  EXPECT_NEAR(image.at(5, 4) / image.at(4, 4), std::exp(-0.5 / (kLensBlur * kLensBlur)), 1e-12);
  EXPECT_NEAR(image.at(5, 5) / image.at(4, 4), std::exp(-1 / (kLensBlur * kLensBlur)), 1e-12);
  double sum = 0;
  for (const double value : image.data) sum += value;
  EXPECT_NEAR(sum, 1, 1e-12);
}

LidarModel small_unit() {
  LidarModel lidar;
  for (int beam = 0; beam < 16; ++beam)
    lidar.beams.push_back({(4 - 0.5 * beam) * M_PI / 180, 0, 0, 0, 1e-6 * beam});
  lidar.azimuth_step = 0.2 * M_PI / 180;
  lidar.azimuth_min = -0.6, lidar.azimuth_max = 0.6;
  lidar.range_min = 1, lidar.range_max = 100;
  lidar.rate = 10;
  return lidar;
}

/// A wall across x = 20 m.
RayScene wall(float lidar = 0.5f, const Vec3f& albedo = Vec3f::Constant(0.5f)) {
  Mesh mesh;
  mesh.vertices = {{20, -60, -30}, {20, 60, -30}, {20, 60, 30}, {20, -60, 30}};
  mesh.faces = {{0, 2, 1}, {0, 3, 2}};
  Surface surface;
  surface.mesh = mesh;
  surface.material.lidar = lidar;
  surface.material.albedo = albedo;
  return RayScene(std::span(&surface, 1));
}

TEST(LidarEffects, AllOffGivesTheGeometryAlone) {
  const RayScene scene = wall();
  const LidarModel lidar = small_unit();
  const Firings firings = simulate_firings(scene, lidar, 1, {});
  for (std::size_t i = 0; i < firings.points.size(); ++i) {
    ASSERT_GT(firings.ranges[i], 0);
    ASSERT_NEAR(firings.points[i].x, 20, 1e-5);
    ASSERT_EQ(firings.points[i].reflectance, 0.5f);
  }
  EXPECT_EQ(firings.points.size(), 16u * as_size(lidar.azimuth_count()));
}

// A wall that approaches at 8 m/s, and a unit that drives towards it, in a scene with its own frame.
TEST(UnitMotion, ReturnsLieWhereThingsWereAsSeenFromOnePlace) {
  Mesh mesh;
  mesh.vertices = {{20, -60, -30}, {20, 60, -30}, {20, 60, 30}, {20, -60, 30}};
  mesh.faces = {{0, 2, 1}, {0, 3, 2}};
  UnitMotion motion;
  motion.scene_from_velo = Eigen::Translation3d(100, 50, 2) * Eigen::AngleAxisd(0.5, Vec3d::UnitZ());
  motion.velocity = Vec3d(12, 0, 0);
  motion.yaw_rate = 0.3;
  const LidarModel lidar = small_unit();
  for (const double speed : {0.0, -8.0}) {
    Surface surface;
    surface.mesh = mesh;
    for (Vec3d& v : surface.mesh.vertices) v = motion.scene_from_velo * v;
    const RayScene scene(std::span(&surface, 1)), none(std::span<const Surface>{});
    motion.parts = {{&scene, motion.scene_from_velo.linear() * Vec3d(speed, 0, 0)}};
    const Firings firings = simulate_firings(none, lidar, 1, LidarEffects(), &motion);
    double farthest = 0;
    for (std::size_t i = 0; i < firings.points.size(); ++i) {
      ASSERT_GT(firings.ranges[i], 0);
      const auto beam = i / as_size(lidar.azimuth_count()), column = i % as_size(lidar.azimuth_count());
      const double time =
          lidar.firing_time(static_cast<int>(beam), lidar.firing_azimuth(static_cast<int>(column)));
      ASSERT_NEAR(firings.points[i].x, 20 + speed * time, 1e-3);
      farthest = std::max(farthest, std::abs(firings.points[i].x - 20.0));
    }
    EXPECT_NEAR(farthest, std::abs(speed) * 0.6 / (2 * std::numbers::pi) * 0.1, 2e-3);
  }
}

TEST(LidarEffects, RangeNoiseHasItsSpreadAndNoBias) {
  LidarEffects effects;
  effects.range_sigma = 0.05;
  const RayScene scene = wall();
  const Firings exact = simulate_firings(scene, small_unit(), 1, {}),
                noisy = simulate_firings(scene, small_unit(), 1, effects);
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < exact.ranges.size(); ++i) {
    const double d = noisy.ranges[i] - exact.ranges[i];
    sum += d;
    squares += d * d;
  }
  const double n = static_cast<double>(exact.ranges.size());
  EXPECT_NEAR(sum / n, 0, 4 * 0.05 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(squares / n), 0.05, 0.003);
}

TEST(LidarEffects, DropOutGrowsWithRangeAndIncidence) {
  LidarEffects effects;
  effects.drop_out = 0.1;
  const RayScene scene = wall();
  const LidarModel lidar = small_unit();
  const auto share = [&](const Firings& firings, bool oblique) {
    double kept = 0, all = 0;
    const int columns = lidar.azimuth_count();
    for (std::size_t i = 0; i < firings.ranges.size(); ++i) {
      const double azimuth = lidar.firing_azimuth(static_cast<int>(i) % columns);
      if ((std::abs(azimuth) > 0.4) != oblique) continue;
      ++all;
      kept += firings.ranges[i] > 0;
    }
    return kept / all;
  };
  EXPECT_NEAR(share(simulate_firings(scene, lidar, 2, effects), false), 0.9, 0.02);
  effects = {};
  effects.signal_floor = 0.5 / 400;  // at 20 m head-on, a share of 1 − 1/e returns
  const Firings faint = simulate_firings(scene, lidar, 2, effects);
  EXPECT_NEAR(share(faint, false), 1 - std::exp(-1.0), 0.04);
  EXPECT_LT(share(faint, true), share(faint, false) - 0.05);
}

TEST(LidarEffects, ReflectanceFromAlbedoAndIncidence) {
  LidarEffects effects;
  effects.albedo = true;
  const RayScene scene = wall(0.1f, Vec3f(0.9f, 0.6f, 0.3f));
  const LidarModel lidar = small_unit();
  const Firings firings = simulate_firings(scene, lidar, 1, effects);
  for (std::size_t i = 0; i < firings.points.size(); ++i)
    ASSERT_NEAR(firings.points[i].reflectance, 0.6 * 20 / firings.ranges[i], 1e-4);
}

// Points of a static wall, moved back by the unit's position at each firing, lie on the wall again.
TEST(LidarEffects, MotionSmearsAStaticSceneByTheFiringTimes) {
  LidarEffects effects;
  effects.velocity = Vec3d(15, 1, 0.2);
  effects.yaw_rate = 0.5;
  const RayScene scene = wall();
  for (int rotation : {1, -1}) {
    LidarModel lidar = small_unit();
    lidar.rotation = rotation;
    const Firings firings = simulate_firings(scene, lidar, 1, effects);
    const int columns = lidar.azimuth_count();
    double smear = 0;
    for (std::size_t i = 0; i < firings.points.size(); ++i) {
      const int beam = static_cast<int>(i) / columns, column = static_cast<int>(i) % columns;
      const double time = lidar.firing_time(beam, lidar.firing_azimuth(column));
      EXPECT_LE(std::abs(time), 0.6 / (2 * M_PI * lidar.rate) + 2e-5);
      const Vec3d p = firings.points[i].position().cast<double>();
      ASSERT_NEAR((start_from_moment(effects, time) * p).x(), 20, 1e-4);
      smear = std::max(smear, std::abs(p.x() - 20));
      // Fired straight ahead at time 0, and later to the left if the unit turns counter-clockwise.
      if (column > 3 * columns / 4) {
        ASSERT_GT(rotation * time, 0);
      }
    }
    EXPECT_GT(smear, 0.1);
  }
}

TEST(LidarEffects, DivergenceMixesWhatTheConeMeets) {
  // A board at 10 m covers the left half of the view; the wall is at 20 m.
  Mesh board;
  board.vertices = {{10, 0, -30}, {10, 60, -30}, {10, 60, 30}, {10, 0, 30}};
  board.faces = {{0, 2, 1}, {0, 3, 2}};
  std::vector<Surface> surfaces(2);
  surfaces[0].mesh = board;
  surfaces[0].material.lidar = 0.5f;
  surfaces[1].mesh.vertices = {{20, -60, -30}, {20, 60, -30}, {20, 60, 30}, {20, -60, 30}};
  surfaces[1].mesh.faces = {{0, 2, 1}, {0, 3, 2}};
  surfaces[1].material.lidar = 0.5f;
  const RayScene scene(surfaces);
  LidarModel lidar = small_unit();
  lidar.azimuth_step = 2e-4;
  lidar.azimuth_min = -0.01, lidar.azimuth_max = 0.01;
  LidarEffects effects;
  effects.divergence = Vec2d(4e-3, 2e-3);
  const Firings thin = simulate_firings(scene, lidar, 1, {}),
                wide = simulate_firings(scene, lidar, 1, effects);
  int won = 0, partial = 0;
  for (std::size_t i = 0; i < thin.ranges.size(); ++i) {
    const bool was_far = thin.ranges[i] > 15, is_far = wide.ranges[i] > 15;
    won += was_far && !is_far;
    EXPECT_FALSE(!was_far && is_far);  // the nearer half of the light is four times as strong
    partial += wide.points[i].reflectance < 0.49f;
    // A return lies on one of the two surfaces, in the direction of the beam's axis.
    const double x = wide.points[i].x;
    EXPECT_TRUE(std::abs(x - 10) < 0.03 || std::abs(x - 20) < 0.06) << x;
  }
  EXPECT_GT(won, 16);      // the board appears wider than it is
  EXPECT_GT(partial, 16);  // and echoes of half a beam are weaker
}

TEST(LidarEffects, StrongestEcho) {
  Echo echo;
  strongest_echo({}, 0.6, echo);
  EXPECT_EQ(echo.strongest, -1);
  const std::vector<Reflection> reflections = {{10, 1}, {20, 0.9}, {20.5, 0.8}, {21.2, 5}, {10.1, 0.2}};
  strongest_echo(reflections, 0.6, echo);
  EXPECT_EQ(echo.strongest, 3);
  EXPECT_THAT(echo.members, testing::ElementsAre(3));
  strongest_echo(reflections, 1, echo);
  EXPECT_THAT(echo.members, testing::ElementsAre(1, 2, 3));
  const std::vector<Reflection> tie = {{20, 1}, {10, 1}};
  strongest_echo(tie, 0.6, echo);
  EXPECT_EQ(echo.strongest, 1);  // the nearer echo
  const std::vector<Reflection> dark = {{20, 0}, {10, 0}};
  strongest_echo(dark, 0.6, echo);
  EXPECT_EQ(echo.strongest, -1);
}

TEST(LidarEffects, WordsNameThem) {
  const Vec2d none = Vec2d::Zero(), beam(3e-3, 1e-3);
  const LidarEffects ideal = parse_lidar_effects("ideal", beam);
  EXPECT_EQ(ideal.range_sigma, 0);
  EXPECT_FALSE(ideal.has_divergence() || ideal.moving());
  const LidarEffects real = parse_lidar_effects("unit", beam), sweeps = generated_sweep_effects();
  EXPECT_EQ(real.range_sigma, sweeps.range_sigma);
  EXPECT_EQ(real.drop_out, sweeps.drop_out);
  EXPECT_EQ(real.signal_floor, sweeps.signal_floor);
  EXPECT_EQ(real.divergence, beam);
  EXPECT_FALSE(real.moving());
  EXPECT_FALSE(real.albedo);
  const LidarEffects some = parse_lidar_effects("motion,albedo,divergence", none);
  EXPECT_TRUE(some.moving() && some.albedo);
  EXPECT_EQ(some.divergence, Vec2d::Constant(2e-3));
  EXPECT_EQ(some.range_sigma, 0);
  for (const char* bad : {"", "rain", "noise,rain", "ideal,noise"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_lidar_effects(bad, none); }),
                testing::StartsWith("lidar_effects: "))
        << bad;
}

TEST(LidarEffects, DarkSurfacesReturnLess) {
  const LidarEffects dark = parse_lidar_effects("dark-loss", Vec2d::Zero());
  EXPECT_TRUE(dark.losing() && dark.any());
  EXPECT_EQ(dark.range_sigma, 0);
  EXPECT_EQ(parse_lidar_effects("unit", Vec2d::Zero()).dark_floor, 0);
  EXPECT_EQ(surface_probability(0.5, LidarEffects()), 1);
  EXPECT_EQ(surface_probability(0, dark), 0);
  EXPECT_NEAR(surface_probability(dark.dark_floor, dark), 1 - std::exp(-1.0), 1e-12);
  double last = 0;
  for (double reflectivity : {0.005, 0.02, 0.1, 0.5, 1.0}) {
    const double share = surface_probability(reflectivity, dark);
    EXPECT_GT(share, last) << reflectivity;
    EXPECT_LT(share, 1) << reflectivity;
    last = share;
  }
}

TEST(LidarEffects, BeamPattern) {
  LidarEffects effects;
  EXPECT_EQ(beam_pattern(effects).size(), 1u);
  effects.divergence = Vec2d(3e-3, 1.2e-3);
  double weight = 0;
  Vec2d mean = Vec2d::Zero();
  for (const SubRay& sub : beam_pattern(effects)) {
    EXPECT_LE(std::abs(sub.angle.x()), 1.5e-3 + 1e-12);
    EXPECT_LE(std::abs(sub.angle.y()), 0.6e-3 + 1e-12);
    weight += sub.weight;
    mean += sub.weight * sub.angle;
  }
  EXPECT_NEAR(weight, 1, 1e-12);
  EXPECT_NEAR(mean.norm(), 0, 1e-12);
}

TEST(LidarEffects, EverySweepDependsOnTheSeedAlone) {
  LidarEffects effects = generated_sweep_effects();
  effects.divergence = Vec2d(2e-3, 2e-3);
  effects.velocity = Vec3d(10, 0, 0);
  const RayScene scene = wall();
  set_thread_count(1);
  const Firings one = simulate_firings(scene, small_unit(), 5, effects);
  set_thread_count(2);
  const Firings two = simulate_firings(scene, small_unit(), 5, effects);
  set_thread_count(0);
  EXPECT_EQ(one.ranges, two.ranges);
  EXPECT_NE(one.ranges, simulate_firings(scene, small_unit(), 6, effects).ranges);
}

TEST(LidarEffects, BadSettingsAreRefusedByName) {
  const auto refused = [](const auto& change) {
    LidarEffects effects;
    change(effects);
    return test::error_text<InputError>([&] { check_effects(effects); });
  };
  using testing::HasSubstr;
  EXPECT_THAT(refused([](LidarEffects& e) { e.range_sigma = std::nan(""); }), HasSubstr("range_sigma"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.drop_out = 1.5; }), HasSubstr("drop_out"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.signal_floor = -1; }), HasSubstr("signal_floor"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.dark_floor = -1; }), HasSubstr("dark_floor"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.divergence.x() = 3; }), HasSubstr("divergence"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.velocity.z() = INFINITY; }), HasSubstr("velocity"));
  EXPECT_THAT(refused([](LidarEffects& e) { e.yaw_rate = 1e9; }), HasSubstr("yaw_rate"));
}

}  // namespace
}  // namespace mirage
