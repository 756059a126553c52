// Exact areas at the extremes: no NaN or Inf, no crash, colours and coverage between 0 and 1, and agreement
// with many samples where those converge.
#include <gtest/gtest.h>

#include <cstdio>

#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/exact_coverage.h"
#include "sensors/projection.h"
#include "support/gradient_check.h"
#include "support/insertion_world.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using test::RasterProblem;

#ifdef MIRAGE_SANITIZE
constexpr int kFewer = 20;
#else
constexpr int kFewer = 1;
#endif

struct ExactOutcome {
  double beyond = 0;    ///< how far colour or coverage leave [0, 1]
  double gradient = 0;  ///< largest component, NDC and m
};

ExactOutcome expect_numbers(const RasterProblem& problem) {
  ExactTape tape;
  draw_exact(problem.mesh, problem.target, tape);
  ExactOutcome outcome;
  for (double value : tape.rgba.data) {
    EXPECT_TRUE(std::isfinite(value));
    outcome.beyond = std::max({outcome.beyond, value - 1, -value});
  }
  const auto gradient = draw_exact_vjp(problem.mesh, problem.target, problem.upstream, tape);
  for (double value : test::flatten(gradient)) {
    EXPECT_TRUE(std::isfinite(value));
    outcome.gradient = std::max(outcome.gradient, std::abs(value));
  }
  for (const auto& corners : gradient.corner_barycentrics)
    for (const Vec3d& d : corners) EXPECT_TRUE(d.allFinite());
  return outcome;
}

double log_spread(RandomStream& random, double low, double high) {
  return std::exp(random.uniform(std::log(low), std::log(high)));
}

/// A face of one of ten kinds: plain, sliver, edge-on, point, repeated corner, huge, tiny, at one depth,
/// partly behind the camera, or with corners on the borders of pixels.
std::array<Vec3d, 3> odd_face(int kind, const PinholeCamera& size, RandomStream& random) {
  std::array<Vec3d, 3> face;
  for (Vec3d& v : face) v = Vec3d{random.uniform(-.8, .8), random.uniform(-.8, .8), random.uniform(3, 9)};
  const double unit = 2.0 / std::max(size.width, size.height);
  switch (kind) {
    case 1:
      face[2].head<2>() = face[1].head<2>() + log_spread(random, 1e-12, 1e-2) * (face[2] - face[1]).head<2>();
      break;
    case 2:
      face[2].head<2>() =
          (face[0] + random.uniform(-.5, 1.5) * (face[1] - face[0])).head<2>() +
          log_spread(random, 1e-16, 1e-3) * Vec2d{random.uniform(-1, 1), random.uniform(-1, 1)};
      break;
    case 3:
      face[1] = face[2] = face[0];
      break;
    case 4:
      face[2] = face[as_size(random.below(2))];
      break;
    case 5:
    case 6: {
      const double factor = kind == 5 ? log_spread(random, 1, 1e6) : log_spread(random, 1e-12, 1);
      for (std::size_t k = 1; k < 3; ++k)
        face[k].head<2>() = face[0].head<2>() + factor * (face[k] - face[0]).head<2>();
      break;
    }
    case 7:
      for (Vec3d& v : face) v.z() = 6;
      break;
    case 8:
      face[as_size(random.below(3))].z() *= -random.uniform();
      break;
    case 9:
      for (Vec3d& v : face)
        v = Vec3d(std::round(v.x() / unit) * unit, std::round(v.y() / unit) * unit, std::round(v.z()));
      break;
    default:
      break;
  }
  return face;
}

TEST(ExactExtremes, RandomFacesOfEveryKind) {
  constexpr int kMeshes = 20000 / kFewer;
  ExactOutcome worst;
  for (int trial = 0; trial < kMeshes; ++trial) {
    RandomStream random(static_cast<std::uint64_t>(trial), "exact extremes");
    RasterProblem problem;
    const PinholeCamera size{
        1, 1, 0, 0, 4 + static_cast<int>(random.below(40)), 4 + static_cast<int>(random.below(30))};
    const int faces = 1 + static_cast<int>(random.below(12));
    for (int f = 0; f < faces; ++f) {
      auto face = odd_face(static_cast<int>(random.below(10)), size, random);
      if (f > 0 && random.below(3) == 0) face[1] = problem.mesh.faces.back()[0];  // shared corners and edges
      if (f > 0 && random.below(3) == 0) face[0] = problem.mesh.faces.back()[2];
      if (f > 0 && random.below(8) == 0) face = problem.mesh.faces.back();
      problem.mesh.faces.push_back(face);
    }
    problem.mesh.resolution = 1 + static_cast<int>(random.below(6));
    const auto texels = as_size(problem.mesh.resolution * problem.mesh.resolution);
    problem.mesh.texels = test::random_colors(problem.mesh.faces.size() * texels, random);
    if (random.below(4) == 0)
      for (std::size_t f = 0; f < problem.mesh.faces.size(); ++f) {  // as parts of clipped faces
        problem.mesh.texel_face.push_back(static_cast<int>(random.below(faces)));
        std::array<Vec3d, 3> corners;
        for (Vec3d& b : corners) {
          b = Vec3d{random.uniform(), random.uniform(), random.uniform()};
          b /= b.sum();
        }
        problem.mesh.corner_barycentrics.push_back(corners);
      }
    const int u0 = static_cast<int>(random.below(size.width)),
              v0 = static_cast<int>(random.below(size.height));
    test::random_window(size.width, size.height,
                        {u0, v0, std::min(size.width, u0 + 1 + static_cast<int>(random.below(30))),
                         std::min(size.height, v0 + 1 + static_cast<int>(random.below(30)))},
                        random, problem);
    if (random.below(3) == 0) {
      problem.target.depth_limit =
          Image<double>(problem.target.rect.width(), problem.target.rect.height(), 1);
      test::fill_random(problem.target.depth_limit, random, 2.5, 9.5);
    }
    SCOPED_TRACE(trial);
    const ExactOutcome outcome = expect_numbers(problem);
    worst.beyond = std::max(worst.beyond, outcome.beyond);
    worst.gradient = std::max(worst.gradient, outcome.gradient);
    if (testing::Test::HasFailure()) break;
  }
  std::printf("%d random meshes: leave [0, 1] by %.1e at most; largest component of a gradient %.1e\n",
              kMeshes, worst.beyond, worst.gradient);
  EXPECT_LE(worst.beyond, 1e-6);
}

/// The ball of test_raster_extremes.cpp with shared vertices.
RasterProblem exact_ball(const Vec3d& centre, double radius, int subdivisions = 2) {
  const PinholeCamera camera{144, 144, 122, 35, 248, 75};
  RandomStream random(1, "exact ball");
  const Mesh shape = icosphere(subdivisions);
  std::vector<Vec3d> p;
  for (const Vec3d& v : shape.vertices) p.push_back(centre + radius * random.uniform(.8, 1.2) * v);
  RasterProblem problem;
  test::random_window(camera.width, camera.height, {0, 0, camera.width, camera.height}, random, problem);
  problem.mesh = project_mesh(p, shape.faces, camera, .1, Texture::atlas, 5,
                              test::random_colors(25 * shape.faces.size(), random))
                     .screen;
  return problem;
}

TEST(ExactExtremes, FromFarAwayToInsideTheMesh) {
  for (const auto& [centre, radius] : {std::pair{Vec3d(.02, -.03, .3), .15},
                                       {Vec3d(.1, .1, 10), .7},
                                       {Vec3d(.1, .1, 500), .7},
                                       {Vec3d(.07, .035, 10), .002},
                                       {Vec3d(.07, .035, 10), 2e-5},
                                       {Vec3d(400, 0, 1000), 600.},
                                       {Vec3d(.75, .1, 0), .7},
                                       {Vec3d(.75, .1, .1), .7},
                                       {Vec3d(.05, -.03, .1), 1.5}}) {
    SCOPED_TRACE(centre.transpose());
    const ExactOutcome outcome = expect_numbers(exact_ball(centre, radius));
    EXPECT_LE(outcome.beyond, 1e-9);
  }
  ExactTape tape;
  const RasterProblem inside = exact_ball({.05, -.03, .1}, 1.5);
  draw_exact(inside.mesh, inside.target, tape);
  for (std::size_t i = 3; i < tape.rgba.data.size(); i += 4) ASSERT_NEAR(tape.rgba.data[i], 1, 1e-9);
}

TEST(ExactExtremes, SmallerThanAPixelItKeepsItsAreaAndItsGradient) {
  for (const double radius : {2e-2, 2e-3, 2e-4}) {  // 1/3 … 1/300 px
    const RasterProblem problem = exact_ball({.07, .035, 10}, radius);
    ExactTape tape;
    draw_exact(problem.mesh, problem.target, tape);
    double sum = 0;
    for (std::size_t i = 3; i < tape.rgba.data.size(); i += 4) sum += tape.rgba.data[i];
    const double disc = M_PI * std::pow(144 * radius / 10, 2);
    EXPECT_GT(sum, .6 * disc);
    EXPECT_LT(sum, 1.5 * disc);
    EXPECT_GT(expect_numbers(problem).gradient, 0);
  }
}

TEST(ExactExtremes, FoldedMeshesAgreeWithManySamples) {
  RasterProblem problem = exact_ball({.3, -.4, 6}, .9, 1);
  RandomStream random(3, "fold");
  for (auto& face : problem.mesh.faces) {  // every face by itself, through all others
    const Vec3d shift{random.uniform(-.05, .05), random.uniform(-.05, .05), random.uniform(-.6, .6)};
    for (Vec3d& v : face) v += shift;
  }
  problem.settings.coverage = Coverage::hard;
  problem.settings.color = ColorBlend::hard;
  problem.settings.silhouette = SilhouetteBlend::hard;
  problem.settings.sigma = 1e-12;
  problem.settings.near = 1;
  problem.settings.far = 20;
  problem.target.supersampling = 16;
  EXPECT_LE(expect_numbers(problem).beyond, 1e-9);
  ExactTape tape;
  draw_exact(problem.mesh, problem.target, tape);
  const Image<double> sampled = rasterize(problem.mesh, problem.settings, problem.target);
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < sampled.data.size(); i += 4) {
    if (sampled.data[i + 3] == 0) continue;
    for (std::size_t c = 0; c < 4; ++c) sum += std::abs(sampled.data[i + c] - tape.rgba.data[i + c]);
    count += 4;
  }
  std::printf("folded mesh, 16 × 16 samples: mean |Δ| %.5f\n", sum / count);
  EXPECT_LT(sum / count, 1.5 / 255);
}

TEST(ExactExtremes, FacesOnScreenThatAreNotFiniteAreSkipped) {
  RasterProblem problem = test::random_problem(3, 6, 1e-6, 1e-2);
  ExactTape before, after;
  draw_exact(problem.mesh, problem.target, before);
  for (double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL})
    for (int c = 0; c < 3; ++c) {
      auto spoilt = problem;
      auto face = spoilt.mesh.faces[2];
      face[1][c] = bad;
      spoilt.mesh.faces.push_back(face);
      for (int t = 0; t < 9; ++t) spoilt.mesh.texels.push_back(Vec3d(.5, .5, .5));
      draw_exact(spoilt.mesh, spoilt.target, after);
      EXPECT_EQ(after.rgba.data, before.rgba.data);
    }
}

TEST(ExactExtremes, InsertionsFromNearToFarAndDegenerate) {
  SimulationSettings settings;
  settings.exact_coverage = true;
  for (int kind = 0; kind < 9; ++kind) {
    SCOPED_TRACE(kind);
    test::World world = test::make_world(1);
    for (Vec3d& v : world.adversary.mesh.vertices) {
      if (kind == 0) v.setZero();
      if (kind == 1) v = Vec3d(v.x(), 0, 0);
      if (kind == 2) v.z() = 0;
      if (kind == 3) v = Vec3d(v.x() * 1e-6, v.y(), v.z());
      if (kind == 4) v = Vec3d(-v.x(), v.y(), std::abs(v.z()) / 2);
    }
    if (kind >= 5) {
      const double distance = kind == 5 ? .3 : kind == 6 ? 1 : kind == 7 ? 60 : 500;
      world.placement.velo_from_adversary.translation() = Vec3d(distance + .7, 0, -.4);
      BevBox& box = world.placement.carrier->label.box.bev;
      box.x = distance + .7;
      box.y = 0;
    }
    const Simulated s = simulate(world.prepared, world.placement, world.adversary, settings);
    for (float value : s.image.data) ASSERT_TRUE(value >= 0 && value <= 1) << value;
    EXPECT_TRUE(s.visible_share >= 0 && s.visible_share <= 1) << s.visible_share;
    const auto gradient = simulate_vjp(s, ImageF(s.image.width, s.image.height, 3, 1.f), {});
    for (const auto* list : {&gradient.vertices, &gradient.texels})
      for (const Vec3d& d : *list) ASSERT_TRUE(d.allFinite());
    if (kind >= 5) {
      EXPECT_GT(s.visible_share, 0);
    }
  }
}

}  // namespace
}  // namespace mirage
