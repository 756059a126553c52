// The LiDAR on random faces and meshes, most of them degenerate.
#include <rapidcheck.h>

#include <cmath>
#include <sstream>

#include "base/sizes.h"
#include "lidar_extremes.h"

namespace mirage {
namespace {

using test::dented_ball;
using test::insert;
using test::kGrazing;
using test::kSteepest;
using test::lidar_frame;
using test::lidar_of_32;
using test::Outcome;

#ifdef MIRAGE_SANITIZE
constexpr int kCases = 2000;
#else
constexpr int kCases = 100000;
#endif

/// A random face, often degenerate, at any distance and place.
struct RandomCase {
  Vec3d origin, direction;
  std::array<Vec3d, 3> face;
};

RandomCase random_case(std::uint64_t seed) {
  RandomStream random(seed, "LiDAR property");
  RandomCase c;
  const double far = std::pow(10, random.uniform(-1, 5));
  c.origin = far * Vec3d{random.normal(), random.normal(), random.normal()};
  c.direction = Vec3d{random.normal(), random.normal(), random.normal()}.normalized();
  const double size = std::pow(10, random.uniform(-3, 1)), range = std::pow(10, random.uniform(-0.5, 2.7));
  const Vec3d centre = c.origin + range * c.direction;
  for (Vec3d& v : c.face) v = centre + size * Vec3d{random.normal(), random.normal(), random.normal()};
  switch (random.below(8)) {
    case 0:
      c.face[1] = c.face[0];
      break;  // repeated
    case 1:
      c.face[2] = c.face[0] + random.uniform() * (c.face[1] - c.face[0]);
      break;  // collinear
    case 2:
      c.face[2] = c.face[0] + 0.5 * (c.face[1] - c.face[0]) + 1e-6 * size * c.direction;
      break;  // needle
    case 3:
      c.face[0] = centre;
      break;  // through a vertex
    case 4:
      c.face[1] = 2 * centre - c.face[0];
      break;  // through an edge
    case 5:   // in the plane
      c.face[1] = c.face[0] + size * c.direction;
      c.face[0] -= (c.face[0] - c.origin) - c.direction * c.direction.dot(c.face[0] - c.origin);
      c.face[1] = c.face[0] + size * c.direction;
      break;
    default:
      break;
  }
  return c;
}

TEST(LidarProperties, ReturnsAndGradientsOfRandomFacesAreFiniteAndBounded) {
  long valid = 0, compared = 0;
  double worst = 0;
  rc::detail::TestParams params;
  params.maxSuccess = kCases;
  params.seed = 20;
  const std::string description = "returns and gradients of random faces";
  const auto result = rc::detail::checkTestable(
      [&] {
        const RandomCase c = random_case(*rc::gen::arbitrary<std::uint32_t>().as("seed"));
        const auto exact = intersect_face<double>(c.origin, c.direction, c.face, 0.5);
        const auto d_face =
            intersect_face_vjp<double>(c.direction, c.face, exact, 0.5, kGrazing, c.direction, 1.0);
        if (!exact.valid) {
          for (const Vec3d& d : d_face) RC_ASSERT(d.isZero(0));
          return;
        }
        ++valid;
        RC_ASSERT(exact.reflectance >= 0 && exact.reflectance <= 0.5 * (1 + 1e-12));
        for (int k = 0; k < 3; ++k) {
          const Vec3d& d = d_face[as_size(k)];
          const double b = std::abs(exact.barycentric[k]);
          if (!std::isfinite(b)) continue;  // beyond the face; draw_in_lidar keeps returns on it
          RC_ASSERT(d.allFinite());
          RC_ASSERT(d.norm() <= (b / kGrazing + 2 * 0.5 / kThinFace) * (1 + 1e-6));
        }
        // Float against double where the ray hits the inside of a well-shaped face near the origin: the error
        // is that of the coordinates over the cosine of incidence.
        if (!(exact.barycentric.minCoeff() >= 0 && exact.range > 0)) return;
        const double scale = c.origin.cwiseAbs().maxCoeff() + exact.range;
        std::array<Vec3f, 3> face;
        for (std::size_t k = 0; k < 3; ++k) face[k] = c.face[k].cast<float>();
        const Vec3d e1 = c.face[1] - c.face[0], e2 = c.face[2] - c.face[0];
        const double sine =
            e1.cross(e2).norm() / std::max({e1.squaredNorm(), e2.squaredNorm(), (e2 - e1).squaredNorm()});
        const double cosine = exact.reflectance / 0.5;
        const double bound = 1e-6 * scale / (cosine * sine);
        if (!(bound <= 0.05 * e1.norm())) return;  // float can't resolve the face
        const auto rough =
            intersect_face<float>(c.origin.cast<float>(), c.direction.cast<float>(), face, 0.5f);
        RC_ASSERT(rough.valid);
        const double error = std::abs(static_cast<double>(rough.range) - exact.range);
        worst = std::max(worst, error / bound);
        ++compared;
        RC_ASSERT(error <= bound);
      },
      rc::detail::TestMetadata{description, description}, params);
  std::ostringstream text;
  rc::detail::printResultMessage(result, text);
  EXPECT_TRUE(result.template is<rc::detail::SuccessResult>()) << text.str();
  EXPECT_GT(valid, kCases / 2);
  EXPECT_GT(compared, kCases / 100);
  std::printf("%d cases, %ld returns, %ld compared with float, worst %.2f of the bound\n", kCases, valid,
              compared, worst);
}

TEST(LidarProperties, InsertionsOfRandomMeshesAreFiniteAndCountTheirPoints) {
  const LidarModel lidar = lidar_of_32(10);
  Sweep wall;
  for (int beam = 0; beam < 32; beam += 2)
    for (int column = 0; column < lidar.azimuth_count(); ++column)
      wall.push_back(test::point_at(lidar.ray(beam, column), 15));
  const PreparedFrame prepared = lidar_frame(lidar, wall);
  for (std::uint64_t seed = 0; seed < static_cast<std::uint64_t>(kCases / 500); ++seed) {
    RandomStream random(seed, "random insertion");
    TexturedMesh object = dented_ball(
        Vec3d{std::pow(10, random.uniform(-0.5, 2)), random.uniform(-3, 3), random.uniform(-2, 1)},
        std::pow(10, random.uniform(-2, 0.5)), seed);
    for (int i = random.below(6); i > 0; --i)  // folded, repeated and torn
      object.mesh.vertices[as_size(random.below(42))] =
          object.mesh.vertices[as_size(random.below(42))] + random.below(2) * Vec3d(random.normal(), 0, 0);
    LidarEffects effects;
    if (random.below(2)) effects.range_sigma = 0.02;
    if (random.below(2)) effects.drop_out = 0.1;
    if (random.below(2)) effects.divergence = Vec2d(3e-3, 1e-3);
    if (random.below(2)) effects.albedo = true;
    if (random.below(2)) effects.velocity = Vec3d{random.normal() * 10, random.normal(), 0};
    const Outcome outcome = insert(prepared, object, effects);
    const Simulated& s = outcome.simulated;
    ASSERT_EQ(s.sweep.size(), wall.size() - as_size(s.removed_points) + as_size(s.adversary_points));
    ASSERT_LE(outcome.steepest, kSteepest);
  }
}

}  // namespace
}  // namespace mirage
