// The picture of exact areas: against known areas, against many samples, and its derivative against central
// differences.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/exact_coverage.h"
#include "sensors/projection.h"
#include "support/files.h"
#include "support/gradient_check.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using test::RasterProblem;

Image<double> drawn(const RasterProblem& problem, const ScreenMesh<double>& mesh) {
  ExactTape tape;
  draw_exact(mesh, problem.target, tape);
  return tape.rgba;
}

Image<double> drawn(const RasterProblem& problem) {
  return drawn(problem, problem.mesh);
}

double sum_of(const Image<double>& rgba, int channel) {
  double sum = 0;
  for (std::size_t i = as_size(channel); i < rgba.data.size(); i += 4) sum += rgba.data[i];
  return sum;
}

/// An empty mesh over a black photograph, with the window as the whole image.
RasterProblem blank(int width, int height) {
  RasterProblem problem;
  problem.mesh.resolution = 1;
  problem.target.width = width;
  problem.target.height = height;
  problem.target.rect = {0, 0, width, height};
  problem.target.background = Image<double>(width, height, 3);
  return problem;
}

/// A point at pixel coordinates (x right, y down, the image's top left corner at 0).
Vec3d at(const RasterProblem& problem, double x, double y, double z) {
  const double half = std::max(problem.target.width, problem.target.height) / 2.0;
  return {(x - problem.target.width / 2.0) / half, (problem.target.height / 2.0 - y) / half, z};
}

double hull_area(std::vector<Vec2d> points) {
  std::sort(points.begin(), points.end(),
            [](const Vec2d& a, const Vec2d& b) { return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y(); });
  double twice = 0;
  for (int side = 0; side < 2; ++side) {
    std::vector<Vec2d> chain;
    for (const Vec2d& p : points) {
      while (chain.size() >= 2 && cross(chain.back() - chain[chain.size() - 2], p - chain.back()) <= 0)
        chain.pop_back();
      chain.push_back(p);
    }
    for (std::size_t i = 0; i + 1 < chain.size(); ++i) twice += cross(chain[i], chain[i + 1]);
    std::reverse(points.begin(), points.end());
  }
  return twice / 2;
}

TEST(ExactCoverage, ATrianglesAreaIsWhatItsPixelsSumUpTo) {
  RandomStream random(1, "exact area");
  double worst = 0;
  for (int trial = 0; trial < 500; ++trial) {
    RasterProblem problem = blank(31, 17);
    Vec2d p[3];
    for (Vec2d& q : p) q = Vec2d{random.uniform(0, 31), random.uniform(0, 17)};
    if (trial % 3 == 0)  // corners and edges on the borders of pixels
      for (Vec2d& q : p) q = Vec2d(std::round(q.x()), std::round(q.y()));
    problem.mesh.faces = {{at(problem, p[0].x(), p[0].y(), 3), at(problem, p[1].x(), p[1].y(), 5),
                           at(problem, p[2].x(), p[2].y(), 9)}};
    problem.mesh.resolution = 1 + trial % 6;
    problem.mesh.texels.assign(as_size(problem.mesh.resolution * problem.mesh.resolution), Vec3d(1, .5, 0));
    const double area = std::abs(cross(p[1] - p[0], p[2] - p[0])) / 2;
    ExactTape tape;
    draw_exact(problem.mesh, problem.target, tape);
    EXPECT_NEAR(sum_of(tape.rgba, 3), area, 1e-10);
    EXPECT_NEAR(sum_of(tape.rgba, 0), area, 1e-10);
    EXPECT_NEAR(sum_of(tape.rgba, 1), area / 2, 1e-10);
    EXPECT_NEAR(tape.area, area, 1e-10);
    worst = std::max(worst, std::abs(sum_of(tape.rgba, 3) - area));
    for (double value : tape.rgba.data) ASSERT_TRUE(value >= 0 && value <= 1) << value;
  }
  std::printf("triangles: worst error of the area %.1e px²\n", worst);
}

TEST(ExactCoverage, AConvexMeshCoversItsOutlineOnceAndWithoutCracks) {
  const PinholeCamera camera{72, 72, 31, 20, 62, 41};
  RandomStream random(2, "exact convex");
  for (int trial = 0; trial < 20; ++trial) {
    const Mesh shape = icosphere(trial % 3);
    const Vec3d stretch{random.uniform(.4, 1), random.uniform(.4, 1), random.uniform(.4, 1)};
    std::vector<Vec3d> p;
    for (const Vec3d& v : shape.vertices) p.push_back(v.cwiseProduct(stretch) + Vec3d(.2, -.1, 5));
    RasterProblem problem = blank(camera.width, camera.height);
    problem.mesh = project_mesh(p, shape.faces, camera, .1, Texture::atlas, 5,
                                std::vector<Vec3d>(25 * shape.faces.size(), Vec3d(.3, .6, .9)))
                       .screen;
    std::vector<Vec2d> on_screen;
    for (const Vec3d& v : p) on_screen.push_back(camera.project(v));
    const Image<double> rgba = drawn(problem);
    EXPECT_NEAR(sum_of(rgba, 3), hull_area(on_screen), 1e-8);
    for (std::size_t i = 0; i < rgba.data.size(); i += 4) {
      ASSERT_TRUE(rgba.data[i + 3] >= 0 && rgba.data[i + 3] <= 1) << rgba.data[i + 3];
      ASSERT_NEAR(rgba.data[i + 1], .6 * rgba.data[i + 3], 1e-11);
    }
    EXPECT_EQ(rgba.at(33, 19, 3), 1);
  }
}

TEST(ExactCoverage, FacesThatCrossShareTheAreaAtTheirLine) {
  // 1/z of the second face is that of the first plus a slope: it is in front to the right of x = 4.3.
  RasterProblem problem = blank(10, 10);
  const auto depth = [](double x, double y) { return 1 / (.2 + .01 * (x - 4.3) + 0 * y); };
  for (int side = 0; side < 2; ++side) {
    std::array<Vec3d, 4> quad;
    for (int k = 0; k < 4; ++k) {
      const double x = k == 1 || k == 2 ? 9 : 1, y = k >= 2 ? 8 : 2;
      quad[as_size(k)] = at(problem, x, y, side ? depth(x, y) : 5);
    }
    problem.mesh.faces.push_back({quad[0], quad[1], quad[2]});
    problem.mesh.faces.push_back({quad[0], quad[2], quad[3]});
    for (int f = 0; f < 2; ++f) problem.mesh.texels.push_back(side ? Vec3d(0, 1, 0) : Vec3d(1, 0, 0));
  }
  const Image<double> rgba = drawn(problem);
  EXPECT_NEAR(sum_of(rgba, 0), 3.3 * 6, 1e-9);
  EXPECT_NEAR(sum_of(rgba, 1), 4.7 * 6, 1e-9);
  EXPECT_NEAR(rgba.at(4, 5, 0), .3, 1e-10);
  EXPECT_NEAR(rgba.at(4, 5, 1), .7, 1e-10);
  EXPECT_EQ(rgba.at(2, 5, 0), 1);
  EXPECT_EQ(rgba.at(0, 5, 3), 0);
}

TEST(ExactCoverage, TheFirstOfTwoFacesInOnePlaneIsSeen) {
  RasterProblem problem = blank(8, 8);
  const std::array<Vec3d, 3> face = {at(problem, 1, 1, 4), at(problem, 7, 1, 5), at(problem, 1, 7, 6)};
  problem.mesh.faces = {face, face};
  problem.mesh.texels = {Vec3d(1, 0, 0), Vec3d(0, 1, 0)};
  const Image<double> rgba = drawn(problem);
  EXPECT_NEAR(sum_of(rgba, 0), 18, 1e-10);
  EXPECT_EQ(sum_of(rgba, 1), 0);
}

TEST(ExactCoverage, SurfacesBehindAPixelsLimitAreNotThere) {
  // z grows from left to right: 1/z = 1/4 − x/80, so z = 5 at x = 4.
  RasterProblem problem = blank(8, 8);
  const auto corner = [&](double x, double y) { return at(problem, x, y, 1 / (.25 - x / 80)); };
  problem.mesh.faces = {{corner(0, 0), corner(8, 0), corner(8, 8)},
                        {corner(0, 0), corner(8, 8), corner(0, 8)}};
  problem.mesh.texels = {Vec3d(1, 1, 1), Vec3d(1, 1, 1)};
  problem.target.depth_limit = Image<double>(8, 8, 1, 100);
  for (int u = 0; u < 8; ++u) problem.target.depth_limit.at(u, 3) = 1 / (.25 - 4.6 / 80);
  problem.target.depth_limit.at(1, 5) = 2;
  const Image<double> rgba = drawn(problem);
  for (int u = 0; u < 8; ++u) {
    EXPECT_EQ(rgba.at(u, 2, 3), 1);
    EXPECT_NEAR(rgba.at(u, 3, 3), u < 4 ? 1 : u > 4 ? 0 : .6, 1e-10) << u;
  }
  EXPECT_EQ(rgba.at(1, 5, 3), 0);
  EXPECT_EQ(rgba.at(1, 5, 0), 0);
  EXPECT_EQ(rgba.at(2, 5, 0), 1);
}

TEST(ExactCoverage, IsWhatEverMoreSamplesApproach) {
  double last = 1;
  for (const int samples : {4, 16, 64}) {
    double worst = 0, mean = 0, count = 0;
    for (std::uint64_t seed = 0; seed < 3; ++seed) {
      RasterProblem problem = test::random_problem(seed, 14, 1e-12, 1e-2);
      problem.settings.coverage = Coverage::hard;
      problem.settings.color = ColorBlend::hard;
      problem.settings.silhouette = SilhouetteBlend::hard;
      problem.target.supersampling = samples;
      const Image<double> exact = drawn(problem);
      const Image<double> sampled = rasterize(problem.mesh, problem.settings, problem.target);
      for (std::size_t i = 0; i < exact.data.size(); ++i) {
        const double error = std::abs(exact.data[i] - sampled.data[i]);
        worst = std::max(worst, error);
        mean += error;
        ++count;
      }
    }
    mean /= count;
    std::printf("%2d × %2d samples: mean |Δ| %.5f (%.3f/255), largest %.4f\n", samples, samples, mean,
                255 * mean, worst);
    EXPECT_LT(mean, last / 3);
    last = mean;
    if (samples == 64) {
      EXPECT_LT(mean, .2 / 255);
      EXPECT_LT(worst, 5. / 255);
    }
  }
}

struct Stable {
  double worst = 0;
  int checked = 0, unstable = 0;
};

/// Central differences, compared where half the step gives the same.
template <class Loss>
void expect_derivative(const Loss& loss, std::vector<double> x, const std::vector<double>& gradient,
                       const std::function<double(std::size_t)>& step_of, Stable& result) {
  ASSERT_EQ(x.size(), gradient.size());
  double largest = 0;
  for (double d : gradient) largest = std::max(largest, std::abs(d));
  const double scale = std::max(1e-3 * largest, 1e-6);
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double here = x[i];
    const auto difference = [&](double h) {
      x[i] = here + h;
      const double above = loss(x);
      x[i] = here - h;
      const double below = loss(x);
      x[i] = here;
      return (above - below) / (2 * h);
    };
    const double step = step_of(i), whole = difference(step), half = difference(step / 2);
    const double error = std::abs(half - gradient[i]) / std::max(scale, std::abs(half));
    if (std::abs(whole - half) > 1e-5 * std::max(scale, std::abs(half))) {
      ++result.unstable;
      continue;
    }
    EXPECT_LE(error, 1e-5) << "component " << i << ": analytic " << gradient[i] << ", numeric " << half;
    result.worst = std::max(result.worst, error);
    ++result.checked;
  }
}

/// Steps of 4e-6 `scale` on screen and 1e-5 m; 0.01 in colours, in which the picture is linear.
void expect_derivative(const RasterProblem& problem, double scale, Stable& result) {
  ExactTape tape;
  draw_exact(problem.mesh, problem.target, tape);
  const auto gradient = draw_exact_vjp(problem.mesh, problem.target, problem.upstream, tape);
  expect_derivative(
      [&](const std::vector<double>& x) {
        return test::dot(drawn(problem, test::unflatten(x, problem.mesh)), problem.upstream);
      },
      test::flatten(problem.mesh), test::flatten(gradient),
      [&](std::size_t i) {
        return i >= 9 * problem.mesh.faces.size() ? 1e-2 : i % 3 == 2 ? 1e-5 : 4e-6 * scale;
      },
      result);
}

void report(const char* what, const Stable& result) {
  std::printf("%s: %d components, worst relative error %.1e; %d left out where differences disagree\n", what,
              result.checked, result.worst, result.unstable);
  EXPECT_GT(result.checked, 100);
  EXPECT_LE(result.unstable, 0.03 * result.checked);
}

TEST(ExactCoverageGradient, FacesThatHideAndCrossEachOther) {
  Stable result;
  for (std::uint64_t seed = 0; seed < 12; ++seed)
    expect_derivative(test::random_problem(seed, 2 + static_cast<int>(seed), 1e-6, 1e-2), 1, result);
  report("random faces", result);
}

TEST(ExactCoverageGradient, WithDepthLimits) {
  Stable result;
  for (std::uint64_t seed = 20; seed < 23; ++seed) {
    RasterProblem problem = test::random_problem(seed, 6, 1e-6, 1e-2);
    RandomStream random(seed, "limits");
    problem.target.depth_limit = Image<double>(problem.target.rect.width(), problem.target.rect.height(), 1);
    test::fill_random(problem.target.depth_limit, random, 3, 9);
    expect_derivative(problem, 1, result);
  }
  report("with depth limits", result);
}

TEST(ExactCoverageGradient, ScalesFromATenthOfAPixelToManyImages) {
  Stable result;
  for (const double scale : {.02, .2, 1., 30.}) {
    RasterProblem problem = test::random_problem(7, 5, 1e-6, 1e-2);
    for (auto& face : problem.mesh.faces)
      for (Vec3d& v : face) v.head<2>() *= scale;
    Stable one;
    expect_derivative(problem, scale, one);
    EXPECT_GT(one.checked, 10) << scale;
    result.worst = std::max(result.worst, one.worst);
    result.checked += one.checked;
    result.unstable += one.unstable;
  }
  report("scales", result);
}

/// A mesh in the camera's frame, with derivatives to its vertices.
void expect_mesh_derivative(const std::vector<Vec3d>& vertices, const std::vector<Face>& faces, double near,
                            const PinholeCamera& camera, std::uint64_t seed, Stable& result) {
  RandomStream random(seed, "exact mesh");
  RasterProblem problem;
  test::random_window(camera.width, camera.height, {1, 2, camera.width - 2, camera.height - 1}, random,
                      problem);
  const auto texels = test::random_colors(25 * faces.size(), random);
  const auto project = [&](const std::vector<Vec3d>& p) {
    return project_mesh(p, faces, camera, near, Texture::atlas, 5, texels);
  };
  const ProjectedMesh projected = project(vertices);
  ExactTape tape;
  draw_exact(projected.screen, problem.target, tape);
  const auto on_screen = draw_exact_vjp(projected.screen, problem.target, problem.upstream, tape);
  std::vector<Vec3d> d_p(vertices.size(), Vec3d::Zero()), d_texels(texels.size(), Vec3d::Zero());
  project_mesh_vjp(projected, vertices, camera, near, on_screen, d_p, d_texels);
  std::vector<double> x, gradient;
  test::append(x, vertices);
  test::append(gradient, d_p);
  expect_derivative(
      [&](const std::vector<double>& moved) {
        std::vector<Vec3d> p(vertices.size());
        for (std::size_t i = 0; i < p.size(); ++i)
          p[i] = Vec3d(moved[3 * i], moved[3 * i + 1], moved[3 * i + 2]);
        return test::dot(drawn(problem, project(p).screen), problem.upstream);
      },
      x, gradient, [](std::size_t) { return 1e-6; }, result);
}

TEST(ExactCoverageGradient, MeshesWithSharedVertices) {
  const PinholeCamera camera{60, 61, 23.5, 15.2, 48, 32};
  Stable smooth, crumpled;
  for (std::uint64_t seed = 0; seed < 3; ++seed) {
    RandomStream random(seed, "exact vertices");
    const Mesh shape = icosphere(1);
    for (const double rough : {.1, .7}) {  // the second one folds and intersects itself
      std::vector<Vec3d> p;
      for (const Vec3d& v : shape.vertices)
        p.push_back(random.uniform(1 - rough, 1 + rough) * v +
                    rough * Vec3d{random.uniform(-.5, .5), random.uniform(-.5, .5), random.uniform(-.5, .5)} +
                    Vec3d(.1, -.1, 5));
      expect_mesh_derivative(p, shape.faces, .1, camera, seed, rough < .5 ? smooth : crumpled);
    }
  }
  report("bumpy balls", smooth);
  report("crumpled balls", crumpled);
}

TEST(ExactCoverageGradient, FacesCutByTheNearPlane) {
  const PinholeCamera camera{20, 21, 11.5, 7.2, 24, 16};
  Stable result;
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    RandomStream random(seed, "exact near plane");
    std::vector<Vec3d> p;
    for (int k = 0; k < 8; ++k)
      p.push_back(Vec3d{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 3)});
    const std::vector<Face> faces = {{0, 1, 2}, {2, 1, 3}, {3, 4, 5}, {5, 6, 0}, {6, 7, 1}, {7, 2, 4}};
    expect_mesh_derivative(p, faces, .5, camera, seed, result);
  }
  report("near plane", result);
}

TEST(ExactCoverage, RefusesWhatItCannotDraw) {
  RasterProblem problem = test::random_problem(1, 3, 1e-6, 1e-2);
  problem.mesh.texels[4].y() = std::nan("");
  EXPECT_THAT(test::error_text<InputError>([&] { drawn(problem); }), testing::HasSubstr("texel 4"));
  problem = test::random_problem(1, 3, 1e-6, 1e-2);
  problem.mesh.texture = Texture::vertex;
  EXPECT_THAT(test::error_text<InputError>([&] { drawn(problem); }), testing::HasSubstr("texture"));
}

}  // namespace
}  // namespace mirage
