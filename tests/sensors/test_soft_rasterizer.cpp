#include <gtest/gtest.h>

#include "sensors/soft_rasterizer.h"
#include "support/gradient_check.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using test::check_gradient;

using test::flatten;
using test::random_problem;
using test::unflatten;
using Problem = test::RasterProblem;

test::GradientCheck check_problem(const Problem& problem, double tolerance) {
  const auto f = [&](const std::vector<double>& x) {
    return test::loss(problem, unflatten(x, problem.mesh));
  };
  const auto gradient = rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream);
  return check_gradient(f, flatten(problem.mesh), flatten(gradient), 1e-6, tolerance, 1e-2);
}

TEST(SoftRasterizerGradient, RandomFacesInEveryBackgroundMode) {
  double worst = 0;
  for (Background background : {Background::paper_logit, Background::silhouette, Background::authors_logit})
    for (std::uint64_t seed : {1u, 2u, 3u}) {
      // σ reaches beyond the window: no pixel crosses the cut-off, so differences are smooth.
      Problem problem = random_problem(seed, 6, .5, 1e-1);
      problem.settings.background = background;
      problem.mesh.resolution = 1;  // the forward pass jumps at texel borders
      problem.mesh.texels.resize(problem.mesh.faces.size());
      worst = std::max(worst, check_problem(problem, 1e-5).worst);
    }
  RecordProperty("worst_relative_error", std::to_string(worst));
  std::printf("worst relative gradient error (random faces): %.2e\n", worst);
}

TEST(SoftRasterizerGradient, SharpSettingsAwayFromTheCutOff) {
  Problem problem = random_problem(7, 4, 1e-3, 5e-2);
  problem.settings.dist_eps = 1e-12;
  problem.mesh.resolution = 1;
  problem.mesh.texels.resize(problem.mesh.faces.size());
  const auto result = check_problem(problem, 2e-4);
  std::printf("worst relative gradient error (sharp): %.2e\n", result.worst);
}

TEST(SoftRasterizerGradient, TexelsAreExact) {
  const Problem problem = random_problem(9, 5, 1e-4, 1e-2);
  const auto f = [&](const std::vector<double>& x) {
    return test::loss(problem, unflatten(x, problem.mesh));
  };
  const auto gradient =
      flatten(rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream));
  const std::size_t first = problem.mesh.faces.size() * 9;
  check_gradient(f, flatten(problem.mesh), gradient, 1e-5, 1e-6, 1e-3,
                 [&](std::size_t i) { return i >= first; });
}

/// Every option against central differences. σ reaches beyond the window and the cut-off lies where D is
/// 1e-12, so that no sample appears or vanishes. Edges and depth orders are jumps in the hard modes, which a
/// step of 1e-7 does not meet in these scenes.
TEST(SoftRasterizerGradient, EveryCombinationOfOptions) {
  double worst = 0;
  int combinations = 0;
  for (Coverage coverage : {Coverage::euclidean, Coverage::barycentric, Coverage::hard})
    for (ColorBlend color : {ColorBlend::softmax, ColorBlend::hard})
      for (SilhouetteBlend silhouette :
           {SilhouetteBlend::product, SilhouetteBlend::sum, SilhouetteBlend::hard})
        for (Background background : {Background::paper_logit, Background::silhouette})
          for (Texture texture : {Texture::atlas, Texture::vertex})
            for (bool perspective : {true, false}) {
              Problem problem = random_problem(40, 4, .5, 1e-1);
              auto& [mesh, settings, target, upstream] = problem;
              mesh.texture = texture;
              mesh.resolution = 1;
              mesh.texels.resize(texture == Texture::atlas ? 4 : 12);
              settings.dist_eps = 1e-12;
              settings.coverage = coverage;
              settings.color = color;
              settings.silhouette = silhouette;
              settings.background = background;
              settings.perspective_texture = perspective;
              settings.sides = static_cast<Sides>(combinations % 3);
              target.supersampling = 1 + combinations % 2;
              SCOPED_TRACE(testing::Message()
                           << "coverage " << int(coverage) << " color " << int(color) << " silhouette "
                           << int(silhouette) << " background " << int(background) << " texture "
                           << int(texture) << " perspective " << perspective);
              const auto gradient = rasterize_vjp(mesh, settings, target, upstream);
              worst = std::max(worst, check_gradient(
                                          [&, &mesh = mesh](const auto& x) {
                                            return test::loss(problem, unflatten(x, mesh));
                                          },
                                          flatten(mesh), flatten(gradient), 1e-7, 2e-5, 1e-1)
                                          .worst);
              ++combinations;
            }
  std::printf("%d combinations, worst relative gradient error %.2e\n", combinations, worst);
}

TEST(SoftRasterizerGradient, DepthLimitAndPartsOfFaces) {
  Problem problem = random_problem(42, 4, .5, 1e-1);
  auto& [mesh, settings, target, upstream] = problem;
  mesh.resolution = 1;
  mesh.texels.resize(2);
  mesh.texel_face = {0, 1, 1, 0};
  mesh.corner_barycentrics.assign(4, {Vec3d(1, 0, 0), Vec3d(0, 1, 0), Vec3d(0, 0, 1)});
  target.depth_limit = Image<double>(target.rect.width(), target.rect.height(), 1);
  RandomStream random(43, "depth limit");
  test::fill_random(target.depth_limit, random, 4, 7);
  const auto gradient = rasterize_vjp(mesh, settings, target, upstream);
  check_gradient([&, &mesh = mesh](const auto& x) { return test::loss(problem, unflatten(x, mesh)); },
                 flatten(mesh), flatten(gradient), 1e-8, 1e-4, 1e-1);
}

/// A face cut in two reads the same texels as the whole face.
TEST(SoftRasterizer, PartsReadTheTextureOfTheWholeFace) {
  Problem whole = random_problem(17, 1, 1e-13, 1e-4);
  Problem parts = whole;
  const auto& face = whole.mesh.faces[0];
  // Splits an edge at a point with linear z: on screen at z-weighted ratios.
  const double t = 0.3;
  Vec3d middle;
  middle.z() = (1 - t) * face[0].z() + t * face[1].z();
  for (int c = 0; c < 2; ++c)
    middle[c] = ((1 - t) * face[0].z() * face[0][c] + t * face[1].z() * face[1][c]) / middle.z();
  parts.mesh.faces = {{face[0], middle, face[2]}, {middle, face[1], face[2]}};
  parts.mesh.texel_face = {0, 0};
  const Vec3d on_edge(1 - t, t, 0);
  parts.mesh.corner_barycentrics = {{Vec3d(1, 0, 0), on_edge, Vec3d(0, 0, 1)},
                                    {on_edge, Vec3d(0, 1, 0), Vec3d(0, 0, 1)}};
  const auto a = rasterize(whole.mesh, whole.settings, whole.target),
             b = rasterize(parts.mesh, parts.settings, parts.target);
  double covered = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) EXPECT_NEAR(a.data[i], b.data[i], 1e-9);
  for (std::size_t i = 3; i < a.data.size(); i += 4) covered += a.data[i];
  EXPECT_GT(covered, 5);
}

TEST(SoftRasterizer, SupersamplingIsTheMeanOfAFinerImage) {
  Problem problem = random_problem(46, 4, 1e-4, 1e-2);
  auto& target = problem.target;
  const int s = 3;
  RasterTarget<double> fine = target;
  fine.width *= s;
  fine.height *= s;
  fine.rect = {s * target.rect.u0, s * target.rect.v0, s * target.rect.u1, s * target.rect.v1};
  fine.background = Image<double>(fine.rect.width(), fine.rect.height(), 3);
  for (int v = 0; v < fine.rect.height(); ++v)
    for (int u = 0; u < fine.rect.width(); ++u)
      for (int c = 0; c < 3; ++c) fine.background.at(u, v, c) = target.background.at(u / s, v / s, c);
  target.supersampling = s;
  const auto mean = rasterize(problem.mesh, problem.settings, target),
             samples = rasterize(problem.mesh, problem.settings, fine);
  for (int v = 0; v < mean.height; ++v)
    for (int u = 0; u < mean.width; ++u)
      for (int c = 0; c < 4; ++c) {
        double sum = 0;
        for (int k = 0; k < s * s; ++k) sum += samples.at(s * u + k % s, s * v + k / s, c);
        EXPECT_NEAR(mean.at(u, v, c), sum / (s * s), 1e-12);
      }
}

TEST(SoftRasterizer, OneSidedColourKeepsTheSilhouette) {
  Problem problem = random_problem(48, 1, 1e-6, 1e-2);
  const auto& face = problem.mesh.faces[0];
  const Vec3d e1 = face[1] - face[0], e2 = face[2] - face[0];
  const bool counter_clockwise = e1.x() * e2.y() - e1.y() * e2.x() > 0;
  const auto draw = [&](Sides sides) {
    problem.settings.sides = sides;
    return rasterize(problem.mesh, problem.settings, problem.target);
  };
  const auto both = draw(Sides::both),
             shown = draw(counter_clockwise ? Sides::counter_clockwise : Sides::clockwise),
             hidden = draw(counter_clockwise ? Sides::clockwise : Sides::counter_clockwise);
  EXPECT_EQ(both.data, shown.data);
  for (int v = 0; v < both.height; ++v)
    for (int u = 0; u < both.width; ++u) {
      EXPECT_EQ(hidden.at(u, v, 3), both.at(u, v, 3));
      for (int c = 0; c < 3; ++c) EXPECT_EQ(hidden.at(u, v, c), problem.target.background.at(u, v, c));
    }
}

TEST(SoftRasterizer, FloatAgreesWithDouble) {
  const Problem problem = random_problem(50, 6, 1e-4, 1e-2);
  ScreenMesh<float> mesh;
  mesh.resolution = problem.mesh.resolution;
  for (const auto& face : problem.mesh.faces)
    mesh.faces.push_back({face[0].cast<float>(), face[1].cast<float>(), face[2].cast<float>()});
  for (const Vec3d& texel : problem.mesh.texels) mesh.texels.push_back(texel.cast<float>());
  SoftRasterSettings<float> settings;
  settings.sigma = 1e-4f;
  settings.gamma = 1e-2f;
  settings.near = 3;
  settings.far = 8;
  RasterTarget<float> target;
  target.width = problem.target.width;
  target.height = problem.target.height;
  target.rect = problem.target.rect;
  target.background = ImageF(target.rect.width(), target.rect.height(), 3);
  for (std::size_t i = 0; i < target.background.data.size(); ++i)
    target.background.data[i] = static_cast<float>(problem.target.background.data[i]);
  const auto in_float = rasterize(mesh, settings, target);
  const auto in_double = rasterize(problem.mesh, problem.settings, problem.target);
  for (std::size_t i = 0; i < in_float.data.size(); ++i)
    EXPECT_NEAR(in_float.data[i], in_double.data[i], 1e-3);
}

TEST(SoftRasterizerGradient, FiniteOnDegenerateFaces) {
  for (double sigma : {1e-9, 1e-5, 1e-1})
    for (double gamma : {1e-6, 1e-2}) {
      Problem problem = random_problem(11, 3, sigma, gamma);
      auto& faces = problem.mesh.faces;
      faces[0][2] = (faces[0][0] + faces[0][1]) / 2;                                     // edge-on
      faces[1][0] = faces[1][1] = faces[1][2];                                           // a point
      faces[2][2] = faces[2][0] + (faces[2][1] - faces[2][0]) * .5 + Vec3d(0, 1e-9, 0);  // nearly edge-on
      for (double value :
           flatten(rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream)))
        EXPECT_TRUE(std::isfinite(value));
      for (double value : rasterize(problem.mesh, problem.settings, problem.target).data)
        EXPECT_TRUE(std::isfinite(value));
    }
}

TEST(SoftRasterizer, FragmentsBehindTheDepthLimitAreDropped) {
  Problem problem = random_problem(13, 5, 1e-4, 1e-2);
  problem.target.depth_limit =
      Image<double>(problem.target.rect.width(), problem.target.rect.height(), 1, 3.9);  // before every face
  const auto rgba = rasterize(problem.mesh, problem.settings, problem.target);
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) {
      EXPECT_EQ(rgba.at(u, v, 3), 0);
      EXPECT_EQ(rgba.at(u, v, 0), problem.target.background.at(u, v, 0));
    }
}

TEST(SoftRasterizer, NearLimitCoversExactlyThePixelsWhoseCentreIsInside) {
  Problem problem = random_problem(17, 1, 1e-13, 1e-4);
  const auto rgba = rasterize(problem.mesh, problem.settings, problem.target);
  const auto& face = problem.mesh.faces[0];
  const auto side = [](const Vec3d& a, const Vec3d& b, const Vec2d& p) {
    return (b.x() - a.x()) * (p.y() - a.y()) - (b.y() - a.y()) * (p.x() - a.x());
  };
  int covered = 0;
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) {
      const Vec2d p = ndc_from_pixel<double>(u + problem.target.rect.u0, v + problem.target.rect.v0,
                                             problem.target.width, problem.target.height);
      const double a = side(face[0], face[1], p), b = side(face[1], face[2], p),
                   c = side(face[2], face[0], p);
      const bool inside = (a > 0) == (b > 0) && (b > 0) == (c > 0);
      EXPECT_NEAR(rgba.at(u, v, 3), inside ? 1 : 0, 1e-6) << u << ", " << v;
      covered += inside;
    }
  EXPECT_GT(covered, 5);
}

}  // namespace
}  // namespace mirage
