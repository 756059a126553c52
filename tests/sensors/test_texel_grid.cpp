// Faces with finer texels than others: every rasteriser draws the same as with these colours on an atlas that
// is fine everywhere, and returns the same gradient.
#include <gtest/gtest.h>

#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/exact_coverage.h"
#include "sensors/light_nodes.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"
#include "sensors/soft_rasterizer.h"
#include "support/instruction_sets.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using test::RasterProblem;

constexpr int kCoarse = 2, kFine = 12;  // its parts are halves, thirds or the texels themselves

TEST(TexelGrid, SaysWhereTexelsAre) {
  const TexelGrid all = 5;
  EXPECT_EQ(all.first_texel(3), 75u);
  EXPECT_EQ(all.texels_of(3), 25u);
  EXPECT_EQ(all.faces_with(200), 8u);
  const TexelGrid own(std::vector<int>{2, 4, 1});
  EXPECT_EQ(own.first_texel(0), 0u);
  EXPECT_EQ(own.first_texel(2), 20u);
  EXPECT_EQ(own.texels_of(1), 16u);
  EXPECT_EQ(own.first.back(), 21);
  EXPECT_EQ(own.faces_with(21), 3u);
}

/// One mesh twice, with the same colours: on its own grid, and on an atlas that is fine everywhere.
struct Pair {
  RasterProblem own, fine;
  std::vector<std::size_t> part_of;  ///< for each fine texel, the grid's texel that contains it
};

/// `near`: the near plane, which cuts some faces at 3.
Pair pair_of(std::uint64_t seed, double near, double sigma) {
  RandomStream random(seed, "texel grid");
  const PinholeCamera camera{60, 60, 30, 20, 62, 41};
  const Mesh shape = icosphere(1);
  std::vector<Vec3d> p;
  for (const Vec3d& v : shape.vertices) p.push_back(random.uniform(.5, 1) * v + Vec3d(.2, -.1, 3.4));
  std::vector<int> resolutions;
  for (std::size_t f = 0; f < shape.faces.size(); ++f)
    resolutions.push_back(kCoarse * (1 + static_cast<int>(random.uniform() * 3)));
  const TexelGrid grid(resolutions);
  std::vector<Vec3d> colors(as_size(grid.first.back()));
  for (Vec3d& color : colors) color = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  Pair pair;
  std::vector<Vec3d> fine;
  for (std::size_t f = 0; f < shape.faces.size(); ++f)
    for (const Vec2d& b : texel_centroids(kFine)) {
      pair.part_of.push_back(grid.first_texel(f) +
                             as_size(texel_index<double>(b.x(), b.y(), grid.resolution_of(f))));
      fine.push_back(colors[pair.part_of.back()]);
    }
  pair.own.settings.sigma = sigma;
  pair.own.settings.near = 1;
  pair.own.settings.far = 6;
  test::random_window(camera.width, camera.height, {4, 3, 58, 38}, random, pair.own);
  pair.own.target.supersampling = 2;
  pair.fine = pair.own;
  pair.own.mesh = project_mesh(p, shape.faces, camera, near, Texture::atlas, grid, colors).screen;
  pair.fine.mesh = project_mesh(p, shape.faces, camera, near, Texture::atlas, kFine, fine).screen;
  return pair;
}

/// Expects equal images, and each texel's gradient to be the sum of its parts'. `share`: of pixels and texels
/// that may differ because a sample lies within rounding of a texel's border.
void expect_alike(const Pair& pair, const Image<double>& own, const Image<double>& fine,
                  const ScreenGradient<double>& d_own, const ScreenGradient<double>& d_fine, double tolerance,
                  double share) {
  ASSERT_EQ(own.data.size(), fine.data.size());
  double covered = 0, different = 0, largest = 0;
  for (std::size_t i = 0; i < own.data.size(); ++i) {
    different += std::abs(own.data[i] - fine.data[i]) > tolerance;
    if (i % 4 == 3) covered += own.data[i];
  }
  EXPECT_GT(covered, 100);
  EXPECT_LE(different, share * static_cast<double>(own.data.size()));
  ASSERT_EQ(d_own.texels.size(), pair.own.mesh.texels.size());
  std::vector<Vec3d> sums(d_own.texels.size(), Vec3d::Zero());
  for (std::size_t t = 0; t < d_fine.texels.size(); ++t) sums[pair.part_of[t]] += d_fine.texels[t];
  different = 0;
  for (std::size_t t = 0; t < sums.size(); ++t) {
    largest = std::max(largest, sums[t].cwiseAbs().maxCoeff());
    different += (sums[t] - d_own.texels[t]).cwiseAbs().maxCoeff() > tolerance;
  }
  EXPECT_GT(largest, 0.1);
  EXPECT_LE(different, share * static_cast<double>(sums.size()));
  // Equal colours give equal gradients of the faces, except at borders between equal colours.
  for (std::size_t f = 0; f < d_own.faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k)
      ASSERT_LT((d_own.faces[f][k] - d_fine.faces[f][k]).norm(),
                (share > 0 ? 1e-2 : 100 * tolerance) * (1 + d_fine.faces[f][k].norm()));
}

TEST(TexelGrid, TheReferenceRasteriserReadsIt) {
  for (const double near : {0.1, 3.0}) {
    const Pair pair = pair_of(1, near, 1e-3);
    const auto draw = [](const RasterProblem& q) { return rasterize(q.mesh, q.settings, q.target); };
    const auto vjp = [](const RasterProblem& q) {
      return rasterize_vjp(q.mesh, q.settings, q.target, q.upstream);
    };
    expect_alike(pair, draw(pair.own), draw(pair.fine), vjp(pair.own), vjp(pair.fine), 1e-9, 0);
  }
}

TEST(TexelGrid, TheKernelReadsItOnEveryInstructionSet) {
  on_every_instruction_set([] {
    for (const double near : {0.1, 3.0}) {
      const Pair pair = pair_of(2, near, 1e-4);
      const auto run = [](const RasterProblem& problem, ScreenGradient<double>& gradient) {
        RasterTarget<float> target;
        target.width = problem.target.width, target.height = problem.target.height;
        target.rect = problem.target.rect, target.supersampling = problem.target.supersampling;
        target.background = to_float(problem.target.background);
        const RasterJob job{&problem.mesh, &problem.settings, &target};
        const ImageF upstream = to_float(problem.upstream);
        RasterTape tape;
        rasterize_batch({&job, 1}, {&tape, 1});
        rasterize_batch_vjp({&job, 1}, {&upstream, 1}, {&tape, 1}, {&gradient, 1});
        return to_double(tape.rgba);
      };
      ScreenGradient<double> d_own, d_fine;
      const Image<double> own = run(pair.own, d_own), fine = run(pair.fine, d_fine);
      expect_alike(pair, own, fine, d_own, d_fine, 1e-4, 0.01);
    }
  });
}

TEST(TexelGrid, ExactAreasReadIt) {
  for (const double near : {0.1, 3.0}) {
    const Pair pair = pair_of(3, near, 1e-6);
    ExactTape own, fine;
    draw_exact(pair.own.mesh, pair.own.target, own);
    draw_exact(pair.fine.mesh, pair.fine.target, fine);
    expect_alike(pair, own.rgba, fine.rgba,
                 draw_exact_vjp(pair.own.mesh, pair.own.target, pair.own.upstream, own),
                 draw_exact_vjp(pair.fine.mesh, pair.fine.target, pair.fine.upstream, fine), 1e-8, 0);
  }
}

}  // namespace
}  // namespace mirage
