// Golden values of Liu et al.'s definition, images and gradients, for every case in the file.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "base/files.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using Problem = test::RasterProblem;

std::filesystem::path golden_file() {
  if (const char* file = std::getenv("MIRAGE_GOLDEN")) return file;
  return std::filesystem::path(MIRAGE_SOURCE) / "../shared/golden/softras.json";
}

#define NEED_GOLDEN_FILE() \
  if (!std::filesystem::exists(golden_file())) GTEST_SKIP() << golden_file() << " is absent (MIRAGE_GOLDEN)"

struct GoldenCase {
  Problem problem;
  nlohmann::json json;
};

/// The option for a word of the authors' interface; `fallback` if the settings lack the key.
template <class Option>
Option option(const nlohmann::json& settings, const char* key, const std::map<std::string, Option>& words,
              Option fallback) {
  return settings.contains(key) ? words.at(settings.at(key).get<std::string>()) : fallback;
}

void read_settings(const nlohmann::json& s, SoftRasterSettings<double>& settings, Texture& texture) {
  settings.sigma = s.at("sigma_val");
  settings.gamma = s.at("gamma_val");
  settings.epsilon = s.at("eps");
  settings.dist_eps = s.at("dist_eps");
  settings.near = s.at("near");
  settings.far = s.at("far");
  settings.sides = s.value("double_side", true) ? Sides::both : Sides::clockwise;
  settings.coverage = option<Coverage>(
      s, "dist_func",
      {{"hard", Coverage::hard}, {"barycentric", Coverage::barycentric}, {"euclidean", Coverage::euclidean}},
      Coverage::euclidean);
  settings.color =
      option<ColorBlend>(s, "aggr_func_rgb", {{"hard", ColorBlend::hard}, {"softmax", ColorBlend::softmax}},
                         ColorBlend::softmax);
  settings.silhouette = option<SilhouetteBlend>(
      s, "aggr_func_alpha",
      {{"hard", SilhouetteBlend::hard}, {"sum", SilhouetteBlend::sum}, {"prod", SilhouetteBlend::product}},
      SilhouetteBlend::product);
  texture = option<Texture>(s, "texture_type", {{"surface", Texture::atlas}, {"vertex", Texture::vertex}},
                            Texture::atlas);
  settings.perspective_texture = false;
  settings.edge_on_altitude = 1e-12;
}

std::vector<GoldenCase> golden_cases() {
  std::vector<GoldenCase> cases;
  const nlohmann::json file = read_json(golden_file());
  for (const auto& json : file.at("cases")) {
    GoldenCase golden;
    golden.json = json;
    auto& [mesh, settings, target, upstream] = golden.problem;
    const auto& s = json.at("settings");
    const int n = s.at("image_size");
    read_settings(s, settings, mesh.texture);
    if (mesh.texture == Texture::atlas) mesh.resolution = json.at("R");
    for (const auto& face : json.at("faces")) {
      std::array<Vec3d, 3> f;
      for (std::size_t k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c) f[k][c] = face.at(k).at(as_size(c));
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
        for (int c = 0; c < 3; ++c) target.background.at(u, v, c) = s.at("background_color").at(as_size(c));
        for (int c = 0; c < 4; ++c)
          upstream.at(u, v, c) =
              c < 3 && json.at("rgb_mask").at(as_size(v)).at(as_size(u)) == 0
                  ? 0.
                  : json.at("upstream").at(as_size(c)).at(as_size(v)).at(as_size(u)).get<double>();
      }
    settings.background = Background::authors_logit;
    cases.push_back(std::move(golden));
  }
  EXPECT_FALSE(cases.empty()) << golden_file() << " holds no case";
  return cases;
}

/// Largest |image − json[channel][row][column]| over the compared pixels.
double worst_difference(const Image<double>& rgba, const nlohmann::json& expected,
                        const nlohmann::json& mask) {
  double worst = 0;
  for (int c = 0; c < 4; ++c)
    for (int v = 0; v < rgba.height; ++v)
      for (int u = 0; u < rgba.width; ++u)
        if (c == 3 || mask.at(as_size(v)).at(as_size(u)) != 0)
          worst =
              std::max(worst, std::abs(rgba.at(u, v, c) -
                                       expected.at(as_size(c)).at(as_size(v)).at(as_size(u)).get<double>()));
  return worst;
}

/// Largest |gradient − json[face][vertex][coordinate]|, relative to the largest expected one (at least 1).
double worst_difference(const ScreenGradient<double>& gradient, const nlohmann::json& expected) {
  double scale = 1, worst = 0;
  for (std::size_t f = 0; f < gradient.faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) {
        const double value = expected.at(f).at(k).at(as_size(c));
        scale = std::max(scale, std::abs(value));
        worst = std::max(worst, std::abs(gradient.faces[f][k][c] - value));
      }
  return worst / scale;
}

TEST(SoftRasterizerGolden, ImagesAndGradients) {
  NEED_GOLDEN_FILE();
  for (auto& [problem, json] : golden_cases()) {
    SCOPED_TRACE(json.at("name"));
    const auto& mask = json.at("rgb_mask");
    const double image =
        worst_difference(rasterize(problem.mesh, problem.settings, problem.target), json.at("rgba"), mask);
    EXPECT_LE(image, 1e-6);
    double paper = 0;
    if (json.contains("rgba_paper_background")) {
      problem.settings.background = Background::paper_logit;
      paper = worst_difference(rasterize(problem.mesh, problem.settings, problem.target),
                               json.at("rgba_paper_background"), mask);
      EXPECT_LE(paper, 1e-6);
      problem.settings.background = Background::authors_logit;
    }
    const auto gradient = rasterize_vjp(problem.mesh, problem.settings, problem.target, problem.upstream);
    const double faces = worst_difference(gradient, json.at("grad_faces_exact"));
    EXPECT_LE(faces, 1e-6);
    double texels = 0;
    const std::size_t per_face = problem.mesh.texels.size() / problem.mesh.faces.size();
    for (std::size_t f = 0; f < problem.mesh.faces.size(); ++f) {
      Vec3d sum = Vec3d::Zero();
      for (std::size_t t = 0; t < per_face; ++t) sum += gradient.texels[f * per_face + t];
      for (int c = 0; c < 3; ++c)
        texels = std::max(
            texels, std::abs(sum[c] - json.at("grad_textures_face_sum").at(f).at(as_size(c)).get<double>()));
    }
    EXPECT_LE(texels, 1e-6);
    std::printf("%s: image %.1e, paper's background %.1e, d faces %.1e, d textures %.1e\n",
                json.at("name").get<std::string>().c_str(), image, paper, faces, texels);
  }
}

/// The authors' gradient holds the barycentrics in the depth constant, and gives none to faces outside near
/// and far, although they count in the silhouette. Both gradients against central differences: ours is the
/// derivative, theirs is not. frozen_barycentrics equals theirs where near and far skip no face.
TEST(SoftRasterizerGolden, OursIsTheExactGradientWhereTheAuthorsTakesAShortCut) {
  NEED_GOLDEN_FILE();
  int theirs_off = 0, reproduced = 0;
  for (auto& [problem, json] : golden_cases()) {
    SCOPED_TRACE(json.at("name"));
    if (!json.contains("grad_faces_softras") || !json.contains("fd_crossed")) continue;
    std::set<std::vector<int>> untrusted;
    for (const auto& entry : json.at("fd_crossed")) untrusted.insert(entry.get<std::vector<int>>());
    const auto& mesh = problem.mesh;
    const auto gradient = rasterize_vjp(mesh, problem.settings, problem.target, problem.upstream);
    double scale = 1;
    for (const auto& face : gradient.faces)
      for (const Vec3d& d : face) scale = std::max(scale, d.cwiseAbs().maxCoeff());
    bool inside_range = true;
    double ours_worst = 0, theirs_worst = 0;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
      for (int k = 0; k < 3; ++k) {
        const double z = mesh.faces[f][as_size(k)].z();
        inside_range = inside_range && z >= problem.settings.near && z <= problem.settings.far;
        for (int c = 0; c < 3; ++c) {
          if (untrusted.contains({static_cast<int>(f), k, c})) continue;
          const double step = 1e-7;
          ScreenMesh<double> above = mesh, below = mesh;
          above.faces[f][as_size(k)][c] += step;
          below.faces[f][as_size(k)][c] -= step;
          const double numeric = (test::loss(problem, above) - test::loss(problem, below)) / (2 * step);
          ours_worst = std::max(ours_worst, std::abs(gradient.faces[f][as_size(k)][c] - numeric));
          theirs_worst = std::max(
              theirs_worst,
              std::abs(json.at("grad_faces_softras").at(f).at(as_size(k)).at(as_size(c)).get<double>() -
                       numeric));
        }
      }
    EXPECT_LE(ours_worst, 1e-5 * scale);
    theirs_off += theirs_worst > 1e-3 * scale;
    double frozen = -1;
    if (inside_range) {
      problem.settings.frozen_barycentrics = true;
      frozen = worst_difference(rasterize_vjp(mesh, problem.settings, problem.target, problem.upstream),
                                json.at("grad_faces_softras"));
      EXPECT_LE(frozen, 1e-6);
      ++reproduced;
    }
    std::printf(
        "%s: of the largest slope, exact is off by %.1e, the authors' by %.1e; frozen is theirs to %.1e\n",
        json.at("name").get<std::string>().c_str(), ours_worst / scale, theirs_worst / scale, frozen);
  }
  EXPECT_GT(theirs_off, 0);
  EXPECT_GT(reproduced, 0);
}

}  // namespace
}  // namespace mirage
