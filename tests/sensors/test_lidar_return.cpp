#include <gtest/gtest.h>

#include "base/random.h"
#include "sensors/lidar_return.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

std::array<Vec3d, 3> face_from(const std::vector<double>& x) {
  return {Vec3d(x[0], x[1], x[2]), Vec3d(x[3], x[4], x[5]), Vec3d(x[6], x[7], x[8])};
}

/// A random face that the ray meets inside.
struct Problem {
  Vec3d origin, direction;
  std::array<Vec3d, 3> face;
};

Problem random_problem(std::uint64_t seed, double tilt) {
  RandomStream random(seed, "return");
  Problem problem;
  problem.origin = Vec3d(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  problem.direction = Vec3d(1, random.uniform(-.3, .3), random.uniform(-.3, .3)).normalized();
  const Vec3d centre = problem.origin + random.uniform(3, 30) * problem.direction;
  const Vec3d side = problem.direction.unitOrthogonal(), up = problem.direction.cross(side);
  const Vec3d along = (side * tilt + problem.direction * std::sqrt(1 - tilt * tilt));
  problem.face = {centre + 0.2 * along, centre - 0.1 * along + 0.15 * up, centre - 0.1 * along - 0.12 * up};
  return problem;
}

TEST(LidarReturn, PositionAndBarycentricsAgree) {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const Problem p = random_problem(seed, 0.7);
    const auto hit = intersect_face<double>(p.origin, p.direction, p.face, 0.5);
    ASSERT_TRUE(hit.valid);
    Vec3d from_barycentrics = Vec3d::Zero();
    for (int k = 0; k < 3; ++k) from_barycentrics += hit.barycentric[k] * p.face[k];
    EXPECT_LT((p.origin + hit.range * p.direction - from_barycentrics).norm(), 1e-10);
    EXPECT_GT(hit.barycentric.minCoeff(), 0);
  }
}

TEST(LidarReturn, GradientAgainstCentralDifferences) {
  double worst = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const Problem p = random_problem(seed, 0.7);
    const Vec3d d_point(0.3, -0.7, 0.9);
    const double d_reflectance = 0.4;
    const auto loss = [&](const std::vector<double>& x) {
      const auto hit = intersect_face<double>(p.origin, p.direction, face_from(x), 0.5);
      return d_point.dot(p.origin + hit.range * p.direction) + d_reflectance * hit.reflectance;
    };
    const auto hit = intersect_face<double>(p.origin, p.direction, p.face, 0.5);
    const auto gradient =
        intersect_face_vjp<double>(p.direction, p.face, hit, 0.5, 1e-6, d_point, d_reflectance);
    worst = std::max(
        worst, test::check_gradient(loss, test::flat(p.face), test::flat(gradient), 1e-6, 1e-6, 1e-2).worst);
  }
  std::printf("worst relative error %.2e\n", worst);
}

TEST(LidarReturn, GrazingHitsKeepTheReturnAndBoundTheGradient) {
  for (double tilt : {1e-2, 1e-4, 1e-8}) {
    const Problem p = random_problem(3, tilt);
    const auto hit = intersect_face<double>(p.origin, p.direction, p.face, 0.5);
    ASSERT_TRUE(hit.valid) << tilt;
    const auto gradient =
        intersect_face_vjp<double>(p.direction, p.face, hit, 0.5, 0.05, Vec3d(1, 1, 1), 0.0);
    for (int k = 0; k < 3; ++k)
      EXPECT_LE(gradient[k].norm(), std::abs(hit.barycentric[k]) * std::sqrt(3) / 0.05 * (1 + 1e-9));
  }
}

TEST(LidarReturn, DegenerateFacesAndParallelRaysAreNotValid) {
  const Vec3d origin(0, 0, 0), direction(1, 0, 0);
  const std::array<Vec3d, 3> point{Vec3d(5, 0, 0), Vec3d(5, 0, 0), Vec3d(5, 0, 0)};
  const std::array<Vec3d, 3> line{Vec3d(5, -1, 0), Vec3d(5, 1, 0), Vec3d(5, 3, 0)};
  const std::array<Vec3d, 3> parallel{Vec3d(5, 0, 0), Vec3d(6, 0, 0), Vec3d(5, 1, 0)};
  for (const auto& face : {point, line, parallel}) {
    const auto hit = intersect_face<double>(origin, direction, face, 0.5);
    EXPECT_FALSE(hit.valid);
    for (const Vec3d& d : intersect_face_vjp<double>(direction, face, hit, 0.5, 0.05, Vec3d(1, 1, 1), 1.0))
      EXPECT_TRUE(d.isZero());
  }
}

}  // namespace
}  // namespace mirage
