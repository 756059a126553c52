// The fast rasteriser against the plain loop in double, on every instruction set of this machine.
#include <gtest/gtest.h>

#include <cmath>

#include "base/parallel.h"
#include "base/random.h"
#include "geometry/mesh.h"
#include "sensors/camera.h"
#include "sensors/raster_batch.h"
#include "support/instruction_sets.h"

namespace mirage {
namespace {

struct Ball {
  ScreenMesh<double> mesh;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  ImageF upstream;

  RasterJob job() const { return {&mesh, &settings, &target}; }
};

/// A bumpy ball of 320 faces with one colour per face (texel borders move with rounding) at `distance`.
Ball ball(std::uint64_t seed, double distance, double sigma, double gamma, int supersampling = 1) {
  RandomStream random(seed, "raster scene");
  const PinholeCamera camera{721, 721, 609, 172, 1242, 375};
  const Mesh shape = icosphere(2);
  Ball scene;
  auto& [mesh, settings, target, upstream] = scene;
  std::vector<Vec3d> p;
  for (const Vec3d& v : shape.vertices)
    p.push_back(0.7 * random.uniform(.8, 1.2) * v + Vec3d(.3, -.4, distance));
  for (const Face& face : shape.faces) {
    std::array<Vec3d, 3> corners;
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec2d pixel = camera.project(p[as_size(face[k])]);
      corners[k] << ndc_from_pixel(pixel.x(), pixel.y(), camera.width, camera.height),
          p[as_size(face[k])].z();
    }
    mesh.faces.push_back(corners);
    const Vec3d color{random.uniform(), random.uniform(), random.uniform()};
    for (int t = 0; t < 4; ++t) mesh.texels.push_back(color);
  }
  mesh.resolution = 2;
  settings.sigma = sigma;
  settings.gamma = gamma;
  settings.near = distance - 1.5;
  settings.far = distance + 1.5;
  target.width = camera.width;
  target.height = camera.height;
  target.supersampling = supersampling;
  target.rect =
      touched_pixels(mesh, settings, camera.width, camera.height, {0, 0, camera.width, camera.height});
  target.background = ImageF(target.rect.width(), target.rect.height(), 3);
  for (float& x : target.background.data) x = static_cast<float>(random.uniform());
  upstream = ImageF(target.rect.width(), target.rect.height(), 4);
  for (float& x : upstream.data) x = static_cast<float>(random.uniform(-1, 1));
  return scene;
}

struct Difference {
  double image = 0, vertices = 0, texels = 0;  ///< largest; gradients relative to the largest component

  void add(const Difference& other) {
    image = std::max(image, other.image);
    vertices = std::max(vertices, other.vertices);
    texels = std::max(texels, other.texels);
  }
  void print() const {
    std::printf("%-8s image %.1e   vertices %.1e   texels %.1e\n", raster_instruction_set(), image, vertices,
                texels);
  }
};

Difference compare(const Ball& scene) {
  Difference difference;
  const auto target = to_double(scene.target);
  const auto expected = rasterize(scene.mesh, scene.settings, target);
  const auto d_expected = rasterize_vjp(scene.mesh, scene.settings, target, to_double(scene.upstream));
  RasterTape tape;
  const RasterJob job = scene.job();
  rasterize_batch({&job, 1}, {&tape, 1});
  ScreenGradient<double> gradient;
  rasterize_batch_vjp({&job, 1}, {&scene.upstream, 1}, {&tape, 1}, {&gradient, 1});
  EXPECT_EQ(tape.rgba.data.size(), expected.data.size());
  for (std::size_t i = 0; i < expected.data.size(); ++i)
    difference.image = std::max(difference.image, std::abs(expected.data[i] - double(tape.rgba.data[i])));
  double largest = 0, largest_texel = 0;
  for (std::size_t f = 0; f < gradient.faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) {
        // z is in units of the depth range, x and y in NDC: compares them on one scale.
        const double error = std::abs(gradient.faces[f][k][c] - d_expected.faces[f][k][c]);
        largest = std::max(largest, std::abs(d_expected.faces[f][k][c]));
        difference.vertices = std::max(difference.vertices, error);
      }
  // Per face: a sample within rounding of a texel's border may go to either side.
  const std::size_t per_face = gradient.texels.size() / gradient.faces.size();
  for (std::size_t f = 0; f < gradient.faces.size(); ++f) {
    Vec3d sum = Vec3d::Zero(), expected_sum = Vec3d::Zero();
    for (std::size_t t = f * per_face; t < (f + 1) * per_face; ++t) {
      sum += gradient.texels[t];
      expected_sum += d_expected.texels[t];
    }
    largest_texel = std::max(largest_texel, expected_sum.cwiseAbs().maxCoeff());
    difference.texels = std::max(difference.texels, (sum - expected_sum).cwiseAbs().maxCoeff());
  }
  difference.vertices /= std::max(largest, 1e-12);
  difference.texels /= std::max(largest_texel, 1e-12);
  return difference;
}

TEST(RasterBatch, AgreesWithTheReferenceOnEveryInstructionSet) {
  on_every_instruction_set([] {
    Difference worst;
    for (const auto& [sigma, gamma, supersampling] :
         {std::tuple{1e-5, 1e-2, 1}, {1e-4, 1e-2, 1}, {5e-7, 1e-2, 2}, {1e-5, 1e-1, 3}}) {
      worst.add(compare(ball(3, 12, sigma, gamma, supersampling)));
    }
    worst.print();
    EXPECT_LE(worst.image, 2e-5);
    EXPECT_LE(worst.vertices, 2e-4);
    EXPECT_LE(worst.texels, 2e-5);
  });
}

/// PyTorch3D's model: a background that competes with the faces, and colours by vertex.
TEST(RasterBatch, DrawsALogitBackgroundAndColoursByVertexAsTheReference) {
  on_every_instruction_set([] {
    Difference worst;
    for (const auto& [sigma, gamma, epsilon] :
         {std::tuple{1e-5, 1e-2, 1e-3}, {1e-5, 1e-4, 1e-10}, {1e-5, 1., .1}})
      for (const bool by_vertex : {false, true})
        for (const bool hard : {false, true}) {
          if (hard && gamma != 1e-2) continue;  // has no γ
          Ball scene = ball(3, 12, sigma, gamma, by_vertex ? 1 : 2);
          SoftRasterSettings<double>& settings = scene.settings;
          settings.epsilon = epsilon;
          if (hard) {
            settings.coverage = Coverage::hard;
            settings.color = ColorBlend::hard;
            settings.silhouette = SilhouetteBlend::hard;
          } else {
            settings.background = Background::paper_logit;
          }
          if (by_vertex) {
            RandomStream random(4, "corner colours");
            scene.mesh.texture = Texture::vertex;
            scene.mesh.texels.resize(3 * scene.mesh.faces.size());
            for (Vec3d& color : scene.mesh.texels)
              for (int c = 0; c < 3; ++c) color[c] = random.uniform();
          }
          ASSERT_TRUE(in_kernel(settings));
          worst.add(compare(scene));
        }
    worst.print();
    EXPECT_LE(worst.image, 2e-4);
    EXPECT_LE(worst.vertices, 2e-4);
    EXPECT_LE(worst.texels, 2e-4);
  });
}

struct Drawn {
  std::vector<ImageF> images;
  std::vector<ScreenGradient<double>> gradients;
};

Drawn draw(const std::vector<Ball>& scenes, std::vector<RasterTape>& tapes) {
  std::vector<RasterJob> jobs;
  std::vector<ImageF> upstream;
  for (const Ball& scene : scenes) {
    jobs.push_back(scene.job());
    upstream.push_back(scene.upstream);
  }
  Drawn drawn;
  drawn.gradients.resize(scenes.size());
  rasterize_batch(jobs, tapes);
  rasterize_batch_vjp(jobs, upstream, tapes, drawn.gradients);
  for (const RasterTape& tape : tapes) drawn.images.push_back(tape.rgba);
  return drawn;
}

void expect_same_bits(const Drawn& a, const Drawn& b) {
  ASSERT_EQ(a.images.size(), b.images.size());
  for (std::size_t i = 0; i < a.images.size(); ++i) {
    EXPECT_EQ(a.images[i].data, b.images[i].data);
    EXPECT_EQ(a.gradients[i].faces, b.gradients[i].faces);
    EXPECT_EQ(a.gradients[i].texels, b.gradients[i].texels);
  }
}

TEST(RasterBatch, SameBitsOnAnyNumberOfThreadsAloneAndInABatch) {
  std::vector<Ball> scenes;
  for (std::uint64_t i = 0; i < 5; ++i)
    scenes.push_back(ball(i, 6 + 3. * static_cast<double>(i), i % 2 ? 1e-5 : 1e-4, 1e-2, i == 3 ? 2 : 1));
  std::vector<RasterTape> tapes(scenes.size());
  const Drawn first = draw(scenes, tapes);
  for (int threads : {1, 2, 7}) {
    set_thread_count(threads);
    SCOPED_TRACE(threads);
    expect_same_bits(first, draw(scenes, tapes));  // with the same tapes again
    std::vector<RasterTape> fresh(scenes.size());
    expect_same_bits(first, draw(scenes, fresh));
  }
  set_thread_count(0);
  Drawn alone;
  for (const Ball& scene : scenes) {
    std::vector<RasterTape> one(1);
    Drawn drawn = draw({scene}, one);
    alone.images.push_back(drawn.images[0]);
    alone.gradients.push_back(drawn.gradients[0]);
  }
  expect_same_bits(first, alone);
}

TEST(RasterBatch, AWindowIsTheSamePixelsOfTheWholeImage) {
  // Pixels outside the window have no effect, up to rounding: tiles begin elsewhere.
  Ball scene = ball(5, 9, 1e-5, 1e-2);
  std::vector<RasterTape> tapes(1);
  const ImageF whole = draw({scene}, tapes).images[0];
  const PixelRect all = scene.target.rect, part{all.u0 + 7, all.v0 + 5, all.u1 - 13, all.v1 - 3};
  Ball cut = scene;
  cut.target.rect = part;
  cut.target.background = ImageF(part.width(), part.height(), 3);
  cut.upstream = ImageF(part.width(), part.height(), 4);
  for (int v = 0; v < part.height(); ++v)
    for (int u = 0; u < part.width(); ++u)
      for (int c = 0; c < 3; ++c)
        cut.target.background.at(u, v, c) = scene.target.background.at(u + 7, v + 5, c);
  const ImageF window = draw({cut}, tapes).images[0];
  for (int v = 0; v < part.height(); ++v)
    for (int u = 0; u < part.width(); ++u)
      for (int c = 0; c < 4; ++c) ASSERT_NEAR(window.at(u, v, c), whole.at(u + 7, v + 5, c), 1e-5);
}

}  // namespace
}  // namespace mirage
