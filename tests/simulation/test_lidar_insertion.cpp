// Returns on an inserted object: occlusion ray by ray, optional effects, and gradients.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "base/sizes.h"
#include "sensors/lidar_sweep.h"
#include "support/gradient_check.h"
#include "support/lidar_world.h"

namespace mirage {
namespace {

using test::dented_ball;
using test::lidar_frame;
using test::lidar_of_32;

/// The discrete choices that must stay the same for the derivative to exist: rays, faces and echoes.
std::vector<int> choices(const LidarTape& tape) {
  std::vector<int> all;
  for (const auto& back : tape.returns) {
    all.insert(all.end(), {back.beam, back.firing, back.count, back.strongest});
    for (int p = 0; p < back.count; ++p) {
      const auto& part = tape.parts[as_size(back.first + p)];
      all.insert(all.end(), {part.face, part.texel});
    }
  }
  return all;
}

/// Compares the VJP with central differences on every vertex coordinate and texel.
void check_vjp(const char* name, const LidarEffects& effects, const PreparedFrame& prepared,
               const TexturedMesh& object) {
  SimulationSettings settings;
  settings.lidar_effects = effects;
  settings.grazing_cosine = 1e-9;  // unbounded: the exact derivative
  Simulated simulated;
  const LidarTape tape = draw_in_lidar(prepared, object, settings, simulated);
  ASSERT_GT(tape.returns.size(), 30u) << name;
  std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {0, 0, 0, 0});
  RandomStream random(4, "upstream points");
  for (std::size_t i = tape.first; i < d_points.size(); ++i)
    for (float& value : d_points[i]) value = static_cast<float>(random.uniform(-1, 1));
  std::vector<Vec3d> d_vertices(object.mesh.vertices.size(), Vec3d::Zero()),
      d_texels(object.atlas.texels.size(), Vec3d::Zero());
  draw_in_lidar_vjp(tape, object, settings, d_points, d_vertices, d_texels);
  const auto fixed = choices(tape);
  const auto loss = [&](const TexturedMesh& moved) {
    Simulated ignored;
    const LidarTape now = draw_in_lidar(prepared, moved, settings, ignored);
    if (choices(now) != fixed) return std::nan("");
    double sum = 0;
    for (std::size_t i = 0; i < now.returns.size(); ++i) {
      const auto& back = now.returns[i];
      const auto& d = d_points[tape.first + i];
      sum += Vec3d(d[0], d[1], d[2]).dot(back.ray.origin + back.range * back.ray.direction) +
             d[3] * back.hit.reflectance;
    }
    return sum;
  };
  const auto with_vertices = [&](const std::vector<double>& x) {
    TexturedMesh moved = object;
    for (std::size_t i = 0; i < moved.mesh.vertices.size(); ++i)
      moved.mesh.vertices[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
    return loss(moved);
  };
  std::vector<double> flat;
  for (const Vec3d& d : d_vertices) flat.insert(flat.end(), d.data(), d.data() + 3);
  const auto x0 = test::flat(object.mesh.vertices);
  constexpr double step = 1e-7;
  const auto smooth = [&](std::size_t i) {
    if (i % 2 == 1) return false;  // half of them, for speed
    auto above = x0, below = x0;
    above[i] += step, below[i] -= step;
    return std::isfinite(with_vertices(above)) && std::isfinite(with_vertices(below));
  };
  const auto on_vertices = test::check_gradient(with_vertices, x0, flat, step, 1e-4, 1e-1, smooth);
  EXPECT_GT(on_vertices.checked, 40) << name;
  std::vector<double> t0, d_t;
  for (const Vec3d& t : object.atlas.texels) t0.insert(t0.end(), t.data(), t.data() + 3);
  for (const Vec3d& d : d_texels) d_t.insert(d_t.end(), d.data(), d.data() + 3);
  const auto on_texels = test::check_gradient(
      [&](const std::vector<double>& x) {
        TexturedMesh painted = object;
        for (std::size_t i = 0; i < painted.atlas.texels.size(); ++i)
          painted.atlas.texels[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
        return loss(painted);
      },
      t0, d_t, 1e-5, 1e-6, 1e-2, [](std::size_t i) { return i % 4 == 0; });
  double texels = 0;
  for (double d : d_t) texels += std::abs(d);
  EXPECT_EQ(texels > 0, effects.albedo) << name;
  std::printf("%-12s %d vertex components, worst %.1e; %d texel components, worst %.1e\n", name,
              on_vertices.checked, on_vertices.worst, on_texels.checked, on_texels.worst);
}

TEST(LidarInsertionGradient, EveryEffectAlone) {
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 1);
  const PreparedFrame prepared = lidar_frame(lidar_of_32(10));
  check_vjp("none", {}, prepared, object);
  LidarEffects effects;
  effects.range_sigma = 0.02;
  check_vjp("range noise", effects, prepared, object);
  effects = {};
  effects.drop_out = 0.1;
  check_vjp("drop-out", effects, prepared, object);
  effects = {};
  effects.divergence = Vec2d(3e-3, 1.2e-3);
  check_vjp("divergence", effects, prepared, object);
  effects = {};
  effects.albedo = true;
  check_vjp("albedo", effects, prepared, object);
  effects = {};
  effects.velocity = Vec3d(14, -1, 0.1);
  effects.yaw_rate = 0.3;
  check_vjp("motion", effects, prepared, object);
}

TEST(LidarInsertionGradient, AllEffectsTogetherBeforeAWall) {
  const LidarModel lidar = lidar_of_32(10);
  Sweep wall;
  for (int beam = 0; beam < 32; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column)
      wall.push_back(test::point_at(lidar.ray(beam, column), 9.4));
  LidarEffects effects;
  effects.range_sigma = 0.01;
  effects.drop_out = 0.02;
  effects.divergence = Vec2d(3e-3, 1.2e-3);
  effects.albedo = true;
  effects.velocity = Vec3d(8, 0, 0);
  effects.yaw_rate = -0.2;
  check_vjp("all", effects, lidar_frame(lidar, wall), dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 2));
}

TEST(LidarInsertion, TheNearerReturnStaysRayByRay) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 3);
  Simulated free;
  const LidarTape alone = draw_in_lidar(lidar_frame(lidar), object, {}, free);
  ASSERT_GT(alone.returns.size(), 100u);
  EXPECT_EQ(free.removed_points, 0);
  EXPECT_EQ(free.occluded_points, 0);
  EXPECT_EQ(free.sweep.size(), alone.returns.size());
  // One ray in three has a return 1 mm in front, one 1 mm behind, and one has none.
  Sweep sweep;
  int in_front = 0, behind = 0, none = 0;
  for (std::size_t i = 0; i < alone.returns.size(); ++i) {
    const auto& back = alone.returns[i];
    if (i % 3 == 2) {
      ++none;
      continue;
    }
    ++(i % 3 == 0 ? in_front : behind);
    sweep.push_back(test::point_at(back.ray, back.range + (i % 3 == 0 ? -1e-3 : 1e-3)));
  }
  sweep.push_back(test::point_at(lidar.ray(3, 5), 20));  // elsewhere
  Simulated simulated;
  const PreparedFrame prepared = lidar_frame(lidar, sweep);
  const LidarTape tape = draw_in_lidar(prepared, object, {}, simulated);
  EXPECT_EQ(simulated.occluded_points, in_front);
  EXPECT_EQ(simulated.removed_points, behind);
  EXPECT_EQ(simulated.adversary_points, behind + none);
  EXPECT_EQ(simulated.sweep.size(), sweep.size() - as_size(behind) + tape.returns.size());
  // The remaining returns are the measured ones, in their order.
  std::size_t k = 0;
  for (std::size_t i = 0, s = 0; i < alone.returns.size(); ++i) {
    if (i % 3 == 2) continue;
    if (i % 3 == 0) {
      EXPECT_EQ(simulated.sweep[k++].position(), sweep[s].position());
    }
    ++s;
  }
  EXPECT_EQ(simulated.sweep[k++].position(), sweep.back().position());
  EXPECT_EQ(k, tape.first);
}

TEST(LidarInsertion, AMeasuredReturnAtTheSameRangeStays) {
  LidarModel lidar;
  lidar.beams = {{0, 0, 0, 0}};
  lidar.azimuth_step = 0.01;
  lidar.azimuth_min = -0.1, lidar.azimuth_max = 0.1;
  lidar.range_max = 100;
  TexturedMesh board;
  board.mesh.vertices = {{8, -1, -1}, {8, 1, -1}, {8, 1, 2}, {8, -1, 2}};
  board.mesh.faces = {{0, 2, 1}, {0, 3, 2}};
  board.atlas.resolution = 1;
  board.atlas.texels.assign(2, Vec3d::Constant(0.5));
  Simulated tie, behind;
  draw_in_lidar(lidar_frame(lidar, {{8, 0, 0, 0.3f}}), board, {}, tie);
  EXPECT_EQ(tie.occluded_points, 1);
  EXPECT_EQ(tie.removed_points, 0);
  EXPECT_EQ(tie.sweep.front().position(), Vec3f(8, 0, 0));
  draw_in_lidar(lidar_frame(lidar, {{8.001f, 0, 0, 0.3f}}), board, {}, behind);
  EXPECT_EQ(behind.occluded_points, 0);
  EXPECT_EQ(behind.removed_points, 1);
}

TEST(LidarInsertion, DuplicatePointsAreEachDecided) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 3);
  Simulated free;
  const LidarTape alone = draw_in_lidar(lidar_frame(lidar), object, {}, free);
  const auto& back = alone.returns[alone.returns.size() / 2];
  const Sweep sweep(5, test::point_at(back.ray, 30));
  Simulated simulated;
  draw_in_lidar(lidar_frame(lidar, sweep), object, {}, simulated);
  EXPECT_EQ(simulated.removed_points, 5);  // none of them is visible through the object
  EXPECT_EQ(static_cast<int>(simulated.sweep.size()), simulated.adversary_points);
}

TEST(LidarInsertion, LostReturnsStillHideWhatIsBehind) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 3);
  Sweep wall;
  for (int beam = 0; beam < 32; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column)
      wall.push_back(test::point_at(lidar.ray(beam, column), 30));
  const PreparedFrame prepared = lidar_frame(lidar, wall);
  SimulationSettings settings;
  Simulated all, some, none, other;
  draw_in_lidar(prepared, object, settings, all);
  EXPECT_EQ(all.lost_points, 0);
  settings.lidar_effects.drop_out = 0.3;
  draw_in_lidar(prepared, object, settings, some);
  EXPECT_EQ(some.removed_points, all.removed_points);
  EXPECT_EQ(some.lost_points + some.adversary_points, all.adversary_points);
  EXPECT_NEAR(some.lost_points, 0.3 * all.adversary_points, 0.1 * all.adversary_points);
  settings.lidar_effects.seed = 1;
  draw_in_lidar(prepared, object, settings, other);
  EXPECT_NE(some.sweep.size(), other.sweep.size());
  settings.lidar_effects.drop_out = 1;
  draw_in_lidar(prepared, object, settings, none);
  EXPECT_EQ(none.adversary_points, 0);
  EXPECT_EQ(none.removed_points, all.removed_points);
}

TEST(LidarInsertion, DarkObjectsLoseTheReturnsThatTheirReflectivitySays) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 3);
  SimulationSettings settings;
  settings.lidar_effects.dark_floor = 0.1;
  for (double reflectivity : {0.02, 0.5}) {
    settings.lidar_reflectivity = reflectivity;
    Simulated some;
    draw_in_lidar(lidar_frame(lidar, {}), object, settings, some);
    const double all = some.adversary_points + some.lost_points;
    const double share = surface_probability(reflectivity, settings.lidar_effects);
    ASSERT_GT(all, 300);
    EXPECT_NEAR(some.adversary_points / all, share, 4 * std::sqrt(share * (1 - share) / all)) << reflectivity;
  }
}

// Without light the echo has no strength, but the wall behind is still hidden.
TEST(LidarInsertion, ABlackObjectHidesWhatIsBehindIt) {
  const LidarModel lidar = lidar_of_32();
  TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 3);
  SimulationSettings settings;
  settings.lidar_effects.albedo = true;
  settings.lidar_effects.divergence = Vec2d(0.002, 0.002);
  Sweep wall;
  for (int beam = 0; beam < 32; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column)
      wall.push_back(test::point_at(lidar.ray(beam, column), 14));
  const PreparedFrame before = lidar_frame(lidar, wall);
  Simulated dark, black;
  object.atlas.texels.assign(object.atlas.texels.size(), Vec3d::Constant(1e-6));
  draw_in_lidar(before, object, settings, dark);
  object.atlas.texels.assign(object.atlas.texels.size(), Vec3d::Zero());
  draw_in_lidar(before, object, settings, black);
  EXPECT_GT(dark.removed_points, 100);
  EXPECT_EQ(black.removed_points, dark.removed_points);
}

TEST(LidarInsertion, MotionWritesPointsAsTheMovingUnitSawThem) {
  const LidarModel lidar = lidar_of_32(10);
  const TexturedMesh object = dented_ball(Vec3d(9, 5, -0.4), 0.8, 3, 2);
  SimulationSettings settings;
  settings.lidar_effects.velocity = Vec3d(14, 0, 0);
  settings.lidar_effects.yaw_rate = 0.2;
  Simulated still, moving;
  const PreparedFrame prepared = lidar_frame(lidar);
  const LidarTape before = draw_in_lidar(prepared, object, {}, still),
                  after = draw_in_lidar(prepared, object, settings, moving);
  Vec3d shift = Vec3d::Zero();
  for (const auto& back : before.returns)
    shift -= (back.ray.origin + back.range * back.ray.direction) / static_cast<double>(before.returns.size());
  for (const auto& back : after.returns) {
    const Vec3d p = back.ray.origin + back.range * back.ray.direction;
    shift += p / static_cast<double>(after.returns.size());
    const double time =
        lidar.firing_time(back.beam, lidar.firing_azimuth(0) + back.firing * lidar.azimuth_step);
    const Vec3d there = start_from_moment(settings.lidar_effects, time) * p;
    Vec3d on_face = Vec3d::Zero();
    const Face& face = object.mesh.faces[as_size(back.face)];
    for (int k = 0; k < 3; ++k)
      on_face += back.hit.barycentric[k] * object.mesh.vertices[as_size(face[as_size(k)])];
    ASSERT_LT((there - on_face).norm(), 1e-9);
  }
  // 8 ms after the frame's time the object is 0.11 m nearer.
  EXPECT_NEAR(shift.x(), -14 * std::atan2(5, 9) / (20 * M_PI), 0.04);
  EXPECT_NEAR(static_cast<double>(after.returns.size()), static_cast<double>(before.returns.size()),
              0.1 * static_cast<double>(before.returns.size()));
}

TEST(LidarInsertion, EchoesAreThoseOfAWholeSweep) {
  // A board at a grazing angle, and behind its outline another one head-on: which of them gives the stronger
  // echo of a beam depends on the falloff with incidence.
  TexturedMesh object;
  object.mesh.vertices = {{9, -0.2, -2}, {9, -0.2, 1}, {13, 0.36, 1}, {13, 0.36, -2},
                          {19, -6, -6},  {19, -6, 4},  {19, 6, 4},    {19, 6, -6}};
  object.mesh.faces = {{0, 1, 2}, {0, 2, 3}, {4, 6, 5}, {4, 7, 6}};
  object.atlas.resolution = 1;
  object.atlas.texels.assign(4, Vec3d::Constant(0.5));
  LidarModel lidar = lidar_of_32();
  lidar.azimuth_step = 3e-4;  // many ways to share a beam between the two
  lidar.azimuth_min = -0.1, lidar.azimuth_max = 0.1;
  SimulationSettings settings;
  settings.lidar_reflectivity = 0.5;
  settings.lidar_effects.divergence = Vec2d(8e-3, 8e-3);
  Simulated simulated;
  const LidarTape inserted = draw_in_lidar(lidar_frame(lidar), object, settings, simulated);
  std::vector<Surface> surfaces(1);
  surfaces[0].mesh = object.mesh;
  surfaces[0].material.lidar = 0.5f;
  const Firings swept = simulate_firings(RayScene(surfaces), lidar, 1, settings.lidar_effects);
  const auto columns = as_size(lidar.azimuth_count());
  int split = 0, other = 0;
  for (const auto& back : inserted.returns) {
    ASSERT_GE(back.firing, 0);
    const double whole = swept.ranges[as_size(back.beam) * columns + as_size(back.firing)];
    split += back.count < 19;
    other += std::abs(whole - back.range) > 0.05;
  }
  EXPECT_GT(split, 500);
  EXPECT_LE(other, 5);  // float against double where two echoes are equal
}

TEST(LidarInsertion, DivergenceWidensTheOutlineAndKeepsTheMiddle) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(12, 0.6, -0.4), 0.8, 3);
  SimulationSettings settings;
  settings.lidar_effects.divergence = Vec2d(3e-3, 1.5e-3);
  Simulated thin, wide;
  const LidarTape before = draw_in_lidar(lidar_frame(lidar), object, {}, thin),
                  after = draw_in_lidar(lidar_frame(lidar), object, settings, wide);
  EXPECT_GT(after.returns.size(), before.returns.size());
  EXPECT_LT(after.returns.size(), 1.3 * static_cast<double>(before.returns.size()));
  for (const auto& back : before.returns) {
    const auto same = std::find_if(after.returns.begin(), after.returns.end(), [&](const auto& other) {
      return other.beam == back.beam && other.firing == back.firing;
    });
    ASSERT_NE(same, after.returns.end());
    EXPECT_NEAR(same->range, back.range, 0.15);
  }
}

}  // namespace
}  // namespace mirage
