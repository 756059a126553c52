#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "base/files.h"
#include "base/random.h"
#include "sensors/soft_rasterizer.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

using test::check_gradient;

std::vector<double> flatten(const ScreenMesh<double>& mesh) {
  std::vector<double> x;
  for (const auto& face : mesh.faces)
    for (const auto& v : face) x.insert(x.end(), v.data(), v.data() + 3);
  for (const auto& t : mesh.texels) x.insert(x.end(), t.data(), t.data() + 3);
  return x;
}

ScreenMesh<double> unflatten(const std::vector<double>& x, const ScreenMesh<double>& like) {
  ScreenMesh<double> mesh = like;
  std::size_t i = 0;
  for (auto& face : mesh.faces)
    for (auto& v : face)
      for (int c = 0; c < 3; ++c) v[c] = x[i++];
  for (auto& t : mesh.texels)
    for (int c = 0; c < 3; ++c) t[c] = x[i++];
  return mesh;
}

std::vector<double> flatten(const ScreenGradient<double>& gradient) {
  std::vector<double> x;
  for (const auto& face : gradient.faces)
    for (const auto& v : face) x.insert(x.end(), v.data(), v.data() + 3);
  for (const auto& t : gradient.texels) x.insert(x.end(), t.data(), t.data() + 3);
  return x;
}

double dot(const Image<double>& a, const Image<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += a.data[i] * b.data[i];
  return sum;
}

struct Problem {
  ScreenMesh<double> mesh;
  SoftRasterSettings<double> settings;
  RasterTarget<double> target;
  Image<double> upstream;
};

/// Overlapping random faces over a random background in a window of a non-square image.
Problem random_problem(std::uint64_t seed, int faces, double sigma, double gamma) {
  RandomStream random(seed, "raster problem");
  Problem problem;
  auto& [mesh, settings, target, upstream] = problem;
  mesh.resolution = 3;
  for (int f = 0; f < faces; ++f) {
    const Vec2d centre(random.uniform(-.4, .4), random.uniform(-.2, .2));
    std::array<Vec3d, 3> face;
    for (auto& v : face)
      v = Vec3d(centre.x() + random.uniform(-.35, .35), centre.y() + random.uniform(-.25, .25),
                random.uniform(4, 7));
    mesh.faces.push_back(face);
    for (int t = 0; t < 9; ++t)
      mesh.texels.push_back(Vec3d(random.uniform(), random.uniform(), random.uniform()));
  }
  settings.sigma = sigma;
  settings.gamma = gamma;
  settings.near = 3;
  settings.far = 8;
  target.width = 30;
  target.height = 16;
  target.rect = {3, 2, 28, 15};
  target.background = Image<double>(target.rect.width(), target.rect.height(), 3);
  for (double& value : target.background.data) value = random.uniform();
  upstream = Image<double>(target.rect.width(), target.rect.height(), 4);
  for (double& value : upstream.data) value = random.uniform(-1, 1);
  return problem;
}

test::GradientCheck check_problem(const Problem& problem, double tolerance) {
  const auto f = [&](const std::vector<double>& x) {
    return dot(rasterize(unflatten(x, problem.mesh), problem.settings, problem.target), problem.upstream);
  };
  const auto gradient = rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream);
  return check_gradient(f, flatten(problem.mesh), flatten(gradient), 1e-6, tolerance, 1e-2);
}

TEST(SoftRasterizerGradient, RandomFacesInEveryBackgroundMode) {
  double worst = 0;
  for (Background background : {Background::paper_logit, Background::silhouette, Background::authors_logit})
    for (std::uint64_t seed : {1, 2, 3}) {
      // σ with a reach beyond the window: no pixel crosses the cut-off, so differences are smooth.
      Problem problem = random_problem(seed, 6, .5, 1e-1);
      problem.settings.background = background;
      problem.mesh.resolution = 1;  // texel borders are jumps of the forward, not slopes
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
    return dot(rasterize(unflatten(x, problem.mesh), problem.settings, problem.target), problem.upstream);
  };
  const auto gradient =
      flatten(rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream));
  const std::size_t first = problem.mesh.faces.size() * 9;
  check_gradient(f, flatten(problem.mesh), gradient, 1e-5, 1e-6, 1e-3,
                 [&](std::size_t i) { return i >= first; });
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

// ---- Golden values of Liu et al.'s definition -------------------------------------------------------------

std::filesystem::path golden_file() {
  if (const char* file = std::getenv("MIRAGE_GOLDEN")) return file;
  return std::filesystem::path(MIRAGE_SOURCE) / "../shared/golden/softras.json";
}

struct GoldenCase {
  Problem problem;
  nlohmann::json json;
};

std::vector<GoldenCase> golden_cases() {
  std::vector<GoldenCase> cases;
  const nlohmann::json file = read_json(golden_file());
  for (const auto& json : file.at("cases")) {
    GoldenCase golden;
    golden.json = json;
    auto& [mesh, settings, target, upstream] = golden.problem;
    const auto& s = json.at("settings");
    const int n = s.at("image_size");
    settings.sigma = s.at("sigma_val");
    settings.gamma = s.at("gamma_val");
    settings.epsilon = s.at("eps");
    settings.dist_eps = s.at("dist_eps");
    settings.near = s.at("near");
    settings.far = s.at("far");
    settings.double_sided = s.at("double_side");
    settings.perspective_texture = false;
    settings.edge_on_altitude = 1e-12;
    mesh.resolution = json.at("R");
    for (const auto& face : json.at("faces")) {
      std::array<Vec3d, 3> f;
      for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c) f[k][c] = face.at(k).at(c);
      mesh.faces.push_back(f);
    }
    for (const auto& face : json.at("textures"))
      for (const auto& texel : face) mesh.texels.push_back(Vec3d(texel.at(0), texel.at(1), texel.at(2)));
    target.width = target.height = n;
    target.rect = {0, 0, n, n};
    target.background = Image<double>(n, n, 3);
    upstream = Image<double>(n, n, 4);
    for (int v = 0; v < n; ++v)
      for (int u = 0; u < n; ++u) {
        for (int c = 0; c < 3; ++c) target.background.at(u, v, c) = s.at("background_color").at(c);
        for (int c = 0; c < 4; ++c)
          upstream.at(u, v, c) = c < 3 && json.at("rgb_mask").at(v).at(u) == 0
                                     ? 0.
                                     : json.at("upstream").at(c).at(v).at(u).get<double>();
      }
    cases.push_back(std::move(golden));
  }
  return cases;
}

TEST(SoftRasterizerGolden, ImagesAndGradients) {
  if (!std::filesystem::exists(golden_file())) GTEST_SKIP() << golden_file() << " is absent (MIRAGE_GOLDEN)";
  for (auto& [problem, json] : golden_cases()) {
    SCOPED_TRACE(json.at("name"));
    const int n = problem.target.width;
    for (const auto& [mode, key] : {std::pair{Background::authors_logit, "rgba"},
                                    std::pair{Background::paper_logit, "rgba_paper_background"}}) {
      problem.settings.background = mode;
      const auto rgba = rasterize(problem.mesh, problem.settings, problem.target);
      double worst = 0;
      for (int c = 0; c < 4; ++c)
        for (int v = 0; v < n; ++v)
          for (int u = 0; u < n; ++u)
            if (c == 3 || json.at("rgb_mask").at(v).at(u) != 0)
              worst =
                  std::max(worst, std::abs(rgba.at(u, v, c) - json.at(key).at(c).at(v).at(u).get<double>()));
      EXPECT_LE(worst, 1e-6) << key;
    }
    problem.settings.background = Background::authors_logit;
    const auto gradient = rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream);
    double scale = 0, worst = 0;
    for (std::size_t f = 0; f < problem.mesh.faces.size(); ++f)
      for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c) {
          const double expected = json.at("grad_faces_exact").at(f).at(k).at(c);
          scale = std::max(scale, std::abs(expected));
          worst = std::max(worst, std::abs(gradient.faces[f][k][c] - expected));
        }
    EXPECT_LE(worst, 1e-6 * std::max(1., scale)) << "faces, largest " << scale;
    const std::size_t per_face = static_cast<std::size_t>(problem.mesh.resolution) * problem.mesh.resolution;
    for (std::size_t f = 0; f < problem.mesh.faces.size(); ++f) {
      Vec3d sum = Vec3d::Zero();
      for (std::size_t t = 0; t < per_face; ++t) sum += gradient.texels[f * per_face + t];
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(sum[c], json.at("grad_textures_face_sum").at(f).at(c).get<double>(), 1e-6);
    }
  }
}

}  // namespace
}  // namespace mirage
