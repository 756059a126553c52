// Random meshes under random settings, 1e5 and more (a twentieth under the sanitizers): no NaN or Inf comes
// out, colours stay between the blended ones, and the fast float path agrees with the plain loop in double.
// RapidCheck shrinks a counterexample to the fewest faces and the simplest kinds.
#include <rapidcheck.h>

#include "raster_extremes.h"

namespace mirage {
namespace {

using test::Extreme;

#ifdef MIRAGE_SANITIZE
constexpr int kShare = 20;
#else
constexpr int kShare = 1;
#endif

enum class Kind { plain, sliver, edge_on, point, repeated, huge, tiny, at_one_depth, behind, offset };

/// A case is a few small choices and a seed: quick to generate, and it shrinks to a few simple faces.
struct Case {
  std::vector<Kind> kinds;
  std::uint64_t seed = 0;
};

std::ostream& operator<<(std::ostream& out, const Case& c) {
  out << "seed " << c.seed << ", kinds";
  for (Kind kind : c.kinds) out << ' ' << static_cast<int>(kind);
  return out;
}

rc::Gen<Case> cases() {
  const auto kind = rc::gen::element(Kind::plain, Kind::sliver, Kind::edge_on, Kind::point, Kind::repeated,
                                     Kind::huge, Kind::tiny, Kind::at_one_depth, Kind::behind, Kind::offset);
  return rc::gen::map(rc::gen::pair(rc::gen::resize(8, rc::gen::container<std::vector<Kind>>(kind)),
                                    rc::gen::inRange(0, 1 << 30)),
                      [](const std::pair<std::vector<Kind>, int>& made) {
                        return Case{made.first, static_cast<std::uint64_t>(made.second)};
                      });
}

double log_uniform(RandomStream& random, double low, double high) {
  return std::exp(random.uniform(std::log(low), std::log(high)));
}

std::array<Vec3d, 3> face_of(Kind kind, RandomStream& random) {
  const auto corner = [&] {
    return Vec3d{random.uniform(-.8, .8), random.uniform(-.8, .8), random.uniform(3, 9)};
  };
  std::array<Vec3d, 3> face{corner(), corner(), corner()};
  const auto scale = [&](double factor) {
    for (std::size_t k = 1; k < 3; ++k)
      face[k].head<2>() = face[0].head<2>() + factor * (face[k] - face[0]).head<2>();
  };
  switch (kind) {
    case Kind::plain:
      break;
    case Kind::sliver:
      face[2].head<2>() = face[1].head<2>() + log_uniform(random, 1e-8, 1e-2) * (face[2] - face[1]).head<2>();
      break;
    case Kind::edge_on:
      face[2].head<2>() =
          (face[0] + random.uniform(-.5, 1.5) * (face[1] - face[0])).head<2>() +
          log_uniform(random, 1e-14, 1e-3) * Vec2d{random.uniform(-1, 1), random.uniform(-1, 1)};
      break;
    case Kind::point:
      face[1] = face[2] = face[0];
      break;
    case Kind::repeated:
      face[2] = face[as_size(random.below(2))];
      break;
    case Kind::huge:
      scale(log_uniform(random, 1, 1e6));
      break;
    case Kind::tiny:
      scale(log_uniform(random, 1e-9, 1));
      break;
    case Kind::at_one_depth: {  // nearly: which of two faces at exactly one depth is seen is rounding
      const double depth = 6 + .01 * random.uniform();
      for (Vec3d& v : face) v.z() = depth;
      break;
    }
    case Kind::behind:
      face[as_size(random.below(3))].z() *= -random.uniform();
      break;
    case Kind::offset:
      for (Vec3d& v : face) v.head<2>() += 1e5 * Vec2d{random.uniform(-1, 1), random.uniform(-1, 1)};
      break;
  }
  return face;
}

Extreme scene_of(const Case& c) {
  RandomStream random(c.seed, "property");
  Extreme extreme;
  auto& [mesh, settings, target, upstream] = extreme;
  for (Kind kind : c.kinds) mesh.faces.push_back(face_of(kind, random));
  mesh.texture = random.below(4) == 0 ? Texture::vertex : Texture::atlas;
  // Odd: where two barycentrics are clipped, the texture is read at exactly 1/2, in an even atlas a border.
  mesh.resolution = 1 + 2 * random.below(3);
  const std::size_t per_face =
      as_size(mesh.texture == Texture::vertex ? 3 : mesh.resolution * mesh.resolution);
  mesh.texels = test::random_colors(mesh.faces.size() * per_face, random);
  if (mesh.texture == Texture::atlas && random.below(4) == 0)
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {  // as parts of clipped faces
      mesh.texel_face.push_back(random.below(static_cast<int>(mesh.faces.size())));
      std::array<Vec3d, 3> corners;
      for (Vec3d& b : corners) {
        b = Vec3d{random.uniform(), random.uniform(), random.uniform()};
        b /= b.sum();
      }
      mesh.corner_barycentrics.push_back(corners);
    }
  settings.sigma = log_uniform(random, 1e-9, 1);
  settings.gamma = log_uniform(random, 1e-8, 10);
  settings.epsilon = random.below(2) ? 1e-3 : random.uniform(0, 1);
  settings.dist_eps = log_uniform(random, 1e-6, 1e-2);
  settings.near = random.uniform(.5, 5);
  settings.far = settings.near + log_uniform(random, 1, 100);
  settings.coverage = static_cast<Coverage>(random.below(3));
  settings.color = static_cast<ColorBlend>(random.below(2));
  settings.silhouette = static_cast<SilhouetteBlend>(random.below(3));
  settings.background = static_cast<Background>(random.below(3));
  settings.sides = static_cast<Sides>(random.below(3));
  settings.perspective_texture = random.below(2);
  settings.frozen_barycentrics = random.below(4) == 0;
  const int width = 4 + random.below(40), height = 4 + random.below(30);
  const int u0 = random.below(width), v0 = random.below(height);
  target.width = width;
  target.height = height;
  target.supersampling = 1 + random.below(3);
  target.rect = {u0, v0, std::min(width, u0 + 1 + random.below(9)),
                 std::min(height, v0 + 1 + random.below(7))};
  target.background = ImageF(target.rect.width(), target.rect.height(), 3);
  test::fill_random(target.background, random, 0, 1);
  if (random.below(3) == 0) {
    target.depth_limit = ImageF(target.rect.width(), target.rect.height(), 1);
    test::fill_random(target.depth_limit, random, 3, 9);
  }
  upstream = ImageF(target.rect.width(), target.rect.height(), 4);
  test::fill_random(upstream, random, -1, 1);
  return extreme;
}

/// A scene for the kernel, soft or hard; one case in four keeps its options, which need the plain loop.
Extreme kernel_scene_of(const Case& c) {
  Extreme extreme = scene_of(c);
  RandomStream random(c.seed, "kernel");
  if (random.below(4) == 0) return extreme;
  auto& settings = extreme.settings;
  const bool hard = random.below(3) == 0;
  settings.coverage = hard ? Coverage::hard : Coverage::euclidean;
  settings.color = hard ? ColorBlend::hard : ColorBlend::softmax;
  settings.silhouette = hard ? SilhouetteBlend::hard : SilhouetteBlend::product;
  if (hard) settings.background = Background::silhouette;
  settings.perspective_texture = true;
  settings.frozen_barycentrics = false;
  return extreme;
}

void expect_property(int count, const char* description, const std::function<void(const Case&)>& property) {
  rc::detail::TestParams parameters;
  parameters.seed = 20;
  parameters.maxSuccess = std::max(1, count / kShare);
  parameters.maxSize = 30;
  const auto result = rc::detail::checkTestable(
      [&] { property(*cases().as("case")); }, rc::detail::TestMetadata{description, description}, parameters);
  const bool success = result.template is<rc::detail::SuccessResult>();
  std::ostringstream text;
  rc::detail::printResultMessage(result, text);
  EXPECT_TRUE(success) << text.str();
  if (success) std::printf("%s: %d random meshes\n", description, parameters.maxSuccess);
}

TEST(RasterProperties, PlainLoopIsFiniteAndBlendsOnlyWhatIsThere) {
  expect_property(50000, "plain loop", [](const Case& c) {
    const Extreme extreme = scene_of(c);
    const auto target = to_double(extreme.target);
    const auto drawn = test::draw_plain(extreme, target, to_double(extreme.upstream));
    RC_ASSERT(test::all_finite(drawn));
    for (double value : drawn.image) RC_ASSERT(value >= -1e-12 && value <= 1 + 1e-12);
  });
}

/// The float image and gradient against the double ones. Degenerate kinds have float neighbours with another
/// gradient, so only ordinary faces must keep the gradient's bound.
TEST(RasterProperties, FastPathIsFiniteAndThePlainLoop) {
  test::Measured worst;
  int ordinary = 0, drawn_by_kernel = 0;
  expect_property(100000, "fast path", [&](const Case& c) {
    const Extreme extreme = kernel_scene_of(c);
    const bool plain =
        std::all_of(c.kinds.begin(), c.kinds.end(), [](Kind kind) { return kind == Kind::plain; });
    const auto measured = test::measure(extreme, plain ? test::Compare::corners : test::Compare::none);
    RC_ASSERT(measured.finite);
    for (double value : test::draw_fast(extreme).image) RC_ASSERT(value >= -1e-5 && value <= 1 + 1e-5);
    RC_ASSERT(measured.excess <= 1);
    worst = test::worse(worst, measured);
    ordinary += plain;
    drawn_by_kernel += in_kernel(extreme.settings);
  });
  EXPECT_LE(worst.undefined, 2e-3 * worst.values);
  test::report("random meshes", worst);
  std::printf("gradients compared on %d meshes of ordinary faces; %d meshes in the kernel\n", ordinary,
              drawn_by_kernel);
  EXPECT_GE(drawn_by_kernel, 100000 / kShare / 2);
}

}  // namespace
}  // namespace mirage
