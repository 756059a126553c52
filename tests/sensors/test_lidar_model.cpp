#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "sensors/lidar_model.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

using test::error_text;
using testing::AllOf;
using testing::HasSubstr;

std::filesystem::path shipped() {
  return std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml";
}

TEST(LidarModel, ShippedRigIsAnHdl64) {
  const LidarModel lidar = read_lidar_model(shipped());
  ASSERT_EQ(lidar.beams.size(), 64u);
  // The data sheet's nominal fan, within the degree of adjustment of single units.
  for (int b = 0; b < 32; ++b)
    EXPECT_NEAR(lidar.beams[as_size(b)].elevation / kDegree, 2 - b / 3.0, 0.5) << b;
  for (int b = 0; b < 32; ++b)
    EXPECT_NEAR(lidar.beams[as_size(b + 32)].elevation / kDegree, -8.83 - b / 2.0, 0.7) << b;
  EXPECT_NEAR(2 * std::numbers::pi / lidar.azimuth_step, 2154, 5);
  EXPECT_NEAR(lidar.height, 1.73, 1e-9);
  for (int c = 0; c < lidar.azimuth_count(); ++c) {
    const double steps = lidar.firing_azimuth(c) / lidar.encoder_step;
    EXPECT_NEAR(steps, std::round(steps), 1e-6);
    EXPECT_GT(lidar.firing_azimuth(c + 1), lidar.firing_azimuth(c));
  }
}

TEST(LidarModel, AWholeTurnFiresOnceAtItsSeam) {
  LidarModel lidar;
  lidar.azimuth_min = -std::numbers::pi, lidar.azimuth_max = std::numbers::pi;
  lidar.azimuth_step = 0.5 * kDegree;
  EXPECT_EQ(lidar.azimuth_count(), 720);
  lidar.azimuth_max = 179.5 * kDegree;
  EXPECT_EQ(lidar.azimuth_count(), 720);
  lidar.azimuth_max = 179 * kDegree;
  EXPECT_EQ(lidar.azimuth_count(), 719);
}

TEST(LidarModel, RaysStartOffTheAxisAndAreUnit) {
  LidarModel lidar;
  lidar.beams = {{-0.1, 0.2, 0.026, 0.05}};
  lidar.azimuth_step = 0.01;
  lidar.azimuth_min = -0.5, lidar.azimuth_max = 0.5;
  EXPECT_EQ(lidar.azimuth_count(), 101);
  const LidarRay ray = lidar.ray(0, 60);
  EXPECT_NEAR(ray.direction.norm(), 1, 1e-14);
  EXPECT_NEAR(std::atan2(ray.direction.y(), ray.direction.x()), 0.1 + 0.05, 1e-12);
  EXPECT_NEAR(std::asin(ray.direction.z()), -0.1, 1e-12);
  EXPECT_NEAR(ray.origin.z(), 0.2, 1e-12);
  EXPECT_NEAR(ray.origin.head<2>().norm(), 0.026, 1e-12);
  // To the left of the direction, from above.
  EXPECT_NEAR(ray.origin.dot(Vec3d::UnitZ().cross(ray.direction)), 0.026 * std::cos(0.1), 1e-12);
}

TEST(LidarModel, MountPoseMovesRays) {
  LidarModel lidar;
  lidar.beams = {{0, 0.2, 0, 0}};
  lidar.azimuth_step = 0.1;
  lidar.velo_from_lidar.translation() = Vec3d(1, 2, 3);
  lidar.velo_from_lidar.linear() = Eigen::AngleAxisd(std::numbers::pi / 2, Vec3d::UnitZ()).matrix();
  EXPECT_TRUE(lidar.ray_at(0, 0).origin.isApprox(Vec3d(1, 2, 3.2), 1e-12));
  EXPECT_TRUE(lidar.ray_at(0, 0).direction.isApprox(Vec3d::UnitY(), 1e-12));
}

TEST(LidarModel, ErrorsNameFileAndKey) {
  test::TemporaryFolder folder;
  const std::string good = read_file(shipped());
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto place = text.find(from);
    EXPECT_NE(place, std::string::npos) << from;
    write_file(folder / "rig.toml", text.replace(place, from.size(), to));
    return error_text<InputError>([&] { read_lidar_model(folder / "rig.toml"); });
  };
  EXPECT_THAT(with("azimuth_step =", "azimuth_stepp ="),
              AllOf(HasSubstr("rig.toml"), HasSubstr("lidar.azimuth_step"), HasSubstr("missing")));
  EXPECT_THAT(with("rate =", "colour = 3\nrate ="),
              AllOf(HasSubstr("rig.toml"), HasSubstr("lidar.colour"), HasSubstr("unknown key")));
  EXPECT_THAT(with("rate =", "rate = \"fast\" #"), AllOf(HasSubstr("lidar.rate"), HasSubstr("not a number")));
  EXPECT_THAT(with("rate =", "rate = -1 #"), AllOf(HasSubstr("lidar.rate"), HasSubstr("out of range")));
  EXPECT_THAT(with("range = [0.9, 80]", "range = [90, 80]"), HasSubstr("lidar.range"));
  EXPECT_THAT(with("azimuth = [-52, 52]", "azimuth = [-52]"), HasSubstr("lidar.azimuth"));
  EXPECT_THAT(with("[  1.937, 0.209, -0.026,   1.404]", "[1, 2]"), HasSubstr("lidar.beams[0]"));
  EXPECT_THAT(with("[  1.937,", "[ -1.937,"), AllOf(HasSubstr("lidar.beams"), HasSubstr("top beam down")));
  EXPECT_THAT(with("[lidar]", "[sonar]"), HasSubstr("lidar: missing key"));
  EXPECT_THAT(with("[lidar]", "[lidar"), AllOf(HasSubstr("rig.toml"), HasSubstr("line ")));
}

std::array<Vec3d, 3> face_from(const std::vector<double>& x) {
  return {Vec3d(x[0], x[1], x[2]), Vec3d(x[3], x[4], x[5]), Vec3d(x[6], x[7], x[8])};
}

/// A random face that the ray hits inside.
struct Problem {
  Vec3d origin, direction;
  std::array<Vec3d, 3> face;
};

Problem random_problem(std::uint64_t seed, double tilt) {
  RandomStream random(seed, "return");
  Problem problem;
  problem.origin = Vec3d{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
  problem.direction = Vec3d{1, random.uniform(-.3, .3), random.uniform(-.3, .3)}.normalized();
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
    for (int k = 0; k < 3; ++k) from_barycentrics += hit.barycentric[k] * p.face[as_size(k)];
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
      EXPECT_LE(gradient[as_size(k)].norm(), std::abs(hit.barycentric[k]) * std::sqrt(3) / 0.05 * (1 + 1e-9));
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
