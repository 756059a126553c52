// Shared by tests of the rasterisers: random scenes on screen, and their inputs as one vector of numbers.
#pragma once

#include <vector>

#include "base/random.h"
#include "sensors/soft_rasterizer.h"
#include "support/random_vector.h"

namespace mirage::test {

inline void append(std::vector<double>& x, const std::vector<Vec3d>& values) {
  for (const Vec3d& v : values) x.insert(x.end(), v.data(), v.data() + 3);
}

/// Faces, then texels; of a ScreenMesh or a ScreenGradient.
template <class Screen>
std::vector<double> flatten(const Screen& screen) {
  std::vector<double> x;
  for (const auto& face : screen.faces)
    for (const auto& v : face) x.insert(x.end(), v.data(), v.data() + 3);
  append(x, screen.texels);
  return x;
}

inline ScreenMesh<double> unflatten(const std::vector<double>& x, const ScreenMesh<double>& like) {
  ScreenMesh<double> mesh = like;
  std::size_t i = 0;
  for (auto& face : mesh.faces)
    for (auto& v : face)
      for (int c = 0; c < 3; ++c) v[c] = x[i++];
  for (auto& t : mesh.texels)
    for (int c = 0; c < 3; ++c) t[c] = x[i++];
  return mesh;
}

inline double dot(const Image<double>& a, const Image<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += a.data[i] * b.data[i];
  return sum;
}

template <class S>
void fill_random(Image<S>& image, RandomStream& random, double low, double high) {
  for (S& value : image.data) value = static_cast<S>(random.uniform(low, high));
}

inline std::vector<Vec3d> random_colors(std::size_t count, RandomStream& random) {
  std::vector<Vec3d> colors;
  for (std::size_t i = 0; i < count; ++i) colors.push_back(random_vector(random, 0, 1));
  return colors;
}

struct RasterProblem {
  ScreenMesh<double> mesh;
  SoftRasterSettings<double> settings;
  RasterTarget<double> target;
  Image<double> upstream;  ///< d loss / d rgba
};

/// A window of an image with a random background and upstream gradient.
inline void random_window(int width, int height, const PixelRect& rect, RandomStream& random,
                          RasterProblem& problem) {
  problem.target.width = width;
  problem.target.height = height;
  problem.target.rect = rect;
  problem.target.background = Image<double>(rect.width(), rect.height(), 3);
  fill_random(problem.target.background, random, 0, 1);
  problem.upstream = Image<double>(rect.width(), rect.height(), 4);
  fill_random(problem.upstream, random, -1, 1);
}

/// Overlapping random faces over a random background in a window of a non-square image; 3×3 texels per face.
inline RasterProblem random_problem(std::uint64_t seed, int faces, double sigma, double gamma) {
  RandomStream random(seed, "raster problem");
  RasterProblem problem;
  ScreenMesh<double>& mesh = problem.mesh;
  mesh.resolution = 3;
  for (int f = 0; f < faces; ++f) {
    const double row = random.uniform(-.2, .2), column = random.uniform(-.4, .4);
    const Vec2d centre(column, row);
    std::array<Vec3d, 3> face;
    for (auto& v : face) {
      const double z = random.uniform(4, 7), y = random.uniform(-.25, .25), x = random.uniform(-.35, .35);
      v = Vec3d(centre.x() + x, centre.y() + y, z);
    }
    mesh.faces.push_back(face);
    for (const Vec3d& texel : random_colors(9, random)) mesh.texels.push_back(texel);
  }
  problem.settings.sigma = sigma;
  problem.settings.gamma = gamma;
  problem.settings.near = 3;
  problem.settings.far = 8;
  random_window(30, 16, {3, 2, 28, 15}, random, problem);
  return problem;
}

inline double loss(const RasterProblem& problem, const ScreenMesh<double>& mesh) {
  return dot(rasterize(mesh, problem.settings, problem.target), problem.upstream);
}

}  // namespace mirage::test
