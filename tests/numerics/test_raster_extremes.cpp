// One test per extreme of the soft rasteriser; src/guide/evidence.md cites them by name.
#include <sys/resource.h>

#include "geometry/mesh.h"
#include "raster_extremes.h"
#include "sensors/projection.h"
#include "support/random_vector.h"

namespace mirage {
namespace {

using test::expect_stable;
using test::Extreme;
using test::Measured;
using test::report;
using test::worse;

constexpr double kNear = 0.1;  // m, where faces are clipped

/// KITTI's camera at a fifth of its size, so that the plain loop is quick.
const PinholeCamera kCamera{144, 144, 122, 35, 248, 75};

/// A bumpy ball of 320 faces around `centre` (camera's frame, m), with near and far as an attack sets them.
/// One colour a face: texel borders are jumps.
Extreme ball(const Vec3d& centre, double radius, const PinholeCamera& camera = kCamera,
             std::uint64_t seed = 1) {
  RandomStream random(seed, "extreme");
  const Mesh shape = icosphere(2);
  std::vector<Vec3d> p;
  for (const Vec3d& v : shape.vertices) p.push_back(centre + radius * random.uniform(.8, 1.2) * v);
  Extreme extreme;
  extreme.mesh = project_mesh(p, shape.faces, camera, kNear, Texture::atlas, 1,
                              test::random_colors(shape.faces.size(), random))
                     .screen;
  const double reach = std::max(1.5, 1.5 * radius);
  extreme.settings.near = std::max(kNear / 2, centre.z() - reach);
  extreme.settings.far = centre.z() + reach;
  test::fit_window(camera.width, camera.height, {0, 0, camera.width, camera.height}, random, extreme);
  return extreme;
}

/// Fits the window again after a change of settings or mesh.
void refit(Extreme& extreme) {
  RandomStream random(2, "extreme window");
  const int width = extreme.target.width, height = extreme.target.height;
  test::fit_window(width, height, {0, 0, width, height}, random, extreme);
}

TEST(RasterExtremes, SigmaFrom1em9To1) {
  Measured worst;
  for (double sigma : {1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.}) {
    SCOPED_TRACE(sigma);
    Extreme extreme = ball({.3, -.4, 10}, .7);
    extreme.settings.sigma = sigma;
    refit(extreme);
    worst = worse(worst, expect_stable(extreme));
  }
  report("sigma 1e-9 ... 1", worst);
}

TEST(RasterExtremes, GammaFrom1em8To10) {
  Measured small, usual;
  for (Background background : {Background::silhouette, Background::paper_logit})
    for (double gamma : {1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1., 10.}) {
      SCOPED_TRACE(gamma);
      Extreme extreme = ball({.3, -.4, 10}, .7);
      extreme.settings.gamma = gamma;
      extreme.settings.background = background;
      Measured& worst = gamma < 1e-4 ? small : usual;
      worst = worse(worst, expect_stable(extreme));
    }
  report("gamma 1e-8 ... 1e-5", small);
  report("gamma 1e-4 ... 10", usual);
}

TEST(RasterExtremes, ObjectFrom30CentimetresTo500Metres) {
  Measured worst;
  for (double distance : {.3, 1., 3., 10., 30., 100., 500.}) {
    SCOPED_TRACE(distance);
    worst = worse(worst, expect_stable(ball({.02, -.03, distance}, distance < 2 ? .15 : .7)));
  }
  report("object at 0.3 ... 500 m", worst);
}

TEST(RasterExtremes, ObjectSmallerThanAPixel) {
  Measured worst;
  for (double radius : {.02, .002, 2e-5}) {  // 1/3, 1/30, 1/3000 px
    SCOPED_TRACE(radius);
    const Extreme extreme = ball({.07, .035, 10}, radius);
    ASSERT_FALSE(extreme.target.rect.empty());
    worst = worse(worst, expect_stable(extreme));
  }
  report("smaller than a pixel", worst);
}

TEST(RasterExtremes, ObjectLargerThanTheImage) {
  Measured worst;
  for (double radius : {4., 40., 400.}) {
    SCOPED_TRACE(radius);
    worst = worse(worst, expect_stable(ball({radius, 0, 2.5 * radius}, 1.5 * radius)));
  }
  report("larger than the image", worst);
}

TEST(RasterExtremes, ObjectPartlyBehindTheCamera) {
  Measured worst;
  for (double depth : {-.2, -.1, 0., .1, .4}) {
    SCOPED_TRACE(depth);
    const Extreme extreme = ball({.75, .1, depth}, .7);
    EXPECT_FALSE(extreme.target.rect.empty());
    worst = worse(worst, expect_stable(extreme));
  }
  report("partly behind the camera", worst);
  EXPECT_TRUE(ball({.9, .1, -5}, .7).target.rect.empty());  // wholly behind: nothing is touched
}

TEST(RasterExtremes, CameraInsideTheMesh) {
  const Extreme extreme = ball({.05, -.03, .1}, 1.5);
  EXPECT_EQ(extreme.target.rect.width(), kCamera.width);
  report("camera inside the mesh", expect_stable(extreme));
}

/// Ten ordinary faces and one replaced by `face`.
Extreme with_face(const std::array<Vec3d, 3>& face, std::uint64_t seed = 3) {
  RandomStream random(seed, "one odd face");
  Extreme extreme;
  for (int f = 0; f < 10; ++f) {
    std::array<Vec3d, 3> other;
    for (Vec3d& v : other) v = test::random_vector(random, {-.3, -.3, 9}, {.3, .3, 11});
    extreme.mesh.faces.push_back(other);
  }
  extreme.mesh.faces[4] = face;
  extreme.mesh.texels = test::random_colors(10, random);
  extreme.settings.near = 8;
  extreme.settings.far = 12;
  test::fit_window(100, 80, {10, 8, 90, 72}, random, extreme);
  return extreme;
}

/// Every coverage, for sharp and soft σ. Barycentrics of a face thinner than a sample's rounding are noise,
/// and so are gradients through them; euclidean coverage does not use them.
Measured expect_stable_face(const std::array<Vec3d, 3>& face) {
  Measured worst;
  for (Coverage coverage : {Coverage::euclidean, Coverage::barycentric, Coverage::hard})
    for (double sigma : {1e-8, 5e-7, 1e-4, 1e-2}) {
      SCOPED_TRACE(testing::Message() << "coverage " << int(coverage) << " sigma " << sigma);
      Extreme extreme = with_face(face);
      extreme.settings.coverage = coverage;
      extreme.settings.sigma = sigma;
      worst = worse(worst, expect_stable(extreme, coverage == Coverage::euclidean ? test::Compare::faces
                                                                                  : test::Compare::none));
    }
  return worst;
}

TEST(RasterExtremes, EdgeOnFaces) {
  Measured worst;
  const Vec3d a(-.21, -.13, 9.5), b(.24, .11, 10.5);
  for (double offset : {1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13, 0.}) {
    SCOPED_TRACE(offset);
    const Vec3d c = (a + b) / 2 + Vec3d(-.11, .24, 0) * offset + Vec3d(0, 0, .4);
    worst = worse(worst, expect_stable_face({a, b, c}));
  }
  report("edge-on faces", worst);
}

TEST(RasterExtremes, FacesWithoutArea) {
  const Vec3d a(.03, .02, 10), b(.2, .1, 10);
  report("zero-area faces", worse(expect_stable_face({a, a, a}), expect_stable_face({a, (a + b) / 2, b})));
}

TEST(RasterExtremes, RepeatedVertices) {
  const Vec3d a(.03, .02, 10), b(.2, .1, 10);
  report("repeated vertices", worse(expect_stable_face({a, b, a}), expect_stable_face({a, a, b})));
}

TEST(RasterExtremes, NeedlesOfAMillionToOne) {
  Measured worst;
  for (double length : {.5, 50., 5e4}) {  // up to a million pixels beyond the image
    const Vec3d along = Vec3d(.8, .6, 0) * length, across = Vec3d(-.6, .8, 0) * (length * 1e-6);
    worst =
        worse(worst, expect_stable_face({Vec3d(-.01, .02, 9.5) - along / 2,
                                         Vec3d(-.01, .02, 10.5) + along / 2, Vec3d(-.01, .02, 10) + across}));
  }
  report("needles of 1e6 : 1", worst);
}

TEST(RasterExtremes, FoldedAndSelfIntersectingMeshes) {
  Measured worst;
  for (std::uint64_t seed : {1u, 2u, 3u}) {
    Extreme extreme = ball({.3, -.4, 10}, .7);
    RandomStream random(seed, "fold");
    for (auto& face : extreme.mesh.faces)  // turned inside out, and through each other
      for (Vec3d& v : face)
        v = Vec3d{-.5 * v.x() + random.uniform(-.05, .05), v.y() + random.uniform(-.05, .05),
                  20 - v.z() + random.uniform(-.5, .5)};
    for (std::size_t f = 0; f + 1 < extreme.mesh.faces.size(); f += 7)
      extreme.mesh.faces[f + 1] = extreme.mesh.faces[f];  // twice the same face
    refit(extreme);
    worst = worse(worst, expect_stable(extreme));
  }
  report("folded, self-intersecting", worst);
}

TEST(RasterExtremes, CoordinatesOffsetBy1e5Metres) {
  const Vec3d far_away(1e5, -1e5, 1e5);
  RandomStream random(4, "offset");
  const Mesh shape = icosphere(2);
  std::vector<Vec3d> here, there;
  for (const Vec3d& v : shape.vertices) here.push_back(.7 * random.uniform(.8, 1.2) * v + Vec3d(.3, -.4, 10));
  for (const Vec3d& p : here) there.push_back((p + far_away) - far_away);  // rounded to double there
  const auto colors = test::random_colors(shape.faces.size(), random);
  Extreme extreme = ball({.3, -.4, 10}, .7);
  const auto screen = [&](const std::vector<Vec3d>& p) {
    return project_mesh(p, shape.faces, kCamera, kNear, Texture::atlas, 1, colors).screen;
  };
  extreme.mesh = screen(there);
  refit(extreme);
  const Measured measured = expect_stable(extreme);
  Extreme reference = extreme;
  reference.mesh = screen(here);
  const auto a = test::draw_fast(extreme), b = test::draw_fast(reference);
  double difference = 0;
  for (std::size_t i = 0; i < a.image.size(); ++i)
    difference = std::max(difference, std::abs(a.image[i] - b.image[i]));
  EXPECT_LE(difference, 1e-4);
  std::printf("the image moves by %.1e\n", difference);
  report("offset of 1e5 m", measured);
}

TEST(RasterExtremes, ImageOfOnePixel) {
  Measured worst;
  for (double distance : {1., 10., 500.})
    for (int supersampling : {1, 4}) {
      Extreme extreme = ball({0, 0, distance}, .7, {1, 1, 0, 0, 1, 1});
      extreme.target.supersampling = supersampling;
      EXPECT_EQ(extreme.target.background.data.size(), 3u);
      worst = worse(worst, expect_stable(extreme));
    }
  report("image of 1x1", worst);
}

TEST(RasterExtremes, ImageOf8192By4096CostsWhatTheObjectTouches) {
  const PinholeCamera large{4800, 4800, 4090, 2040, 8192, 4096};
  struct rusage before, after;
  getrusage(RUSAGE_SELF, &before);
  Extreme extreme = ball({5, 2, 30}, .2, large);
  EXPECT_LT(extreme.target.rect.width(), 120);
  test::draw_fast(extreme);
  getrusage(RUSAGE_SELF, &after);
  // The image's own samples would take 537 MB.
  EXPECT_LT(after.ru_maxrss - before.ru_maxrss, 64 * 1024);
  report("image of 8192x4096", expect_stable(extreme));
}

TEST(RasterExtremes, AllTexelsZeroOrOne) {
  Measured worst;
  for (double value : {0., 1.}) {
    Extreme extreme = ball({.3, -.4, 10}, .7);
    for (Vec3d& texel : extreme.mesh.texels) texel.setConstant(value);
    for (float& x : extreme.target.background.data) x = static_cast<float>(1 - value);
    worst = worse(worst, expect_stable(extreme));
    for (double x : test::draw_fast(extreme).image) {
      EXPECT_GE(x, 0);
      EXPECT_LE(x, 1);
    }
  }
  report("all texels 0 or 1", worst);
}

TEST(RasterExtremes, NoFaceAtAll) {
  Extreme extreme = with_face({Vec3d(0, 0, 10), Vec3d(.1, 0, 10), Vec3d(0, .1, 10)});
  extreme.mesh.faces.clear();
  extreme.mesh.texels.clear();
  expect_stable(extreme);
  const auto drawn = test::draw_fast(extreme);
  for (std::size_t i = 0; i < drawn.image.size(); ++i)
    EXPECT_EQ(drawn.image[i], i % 4 == 3 ? 0 : extreme.target.background.data[i / 4 * 3 + i % 4]);
}

}  // namespace
}  // namespace mirage
