#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/random.h"
#include "geometry/convex_polytope.h"

namespace mirage {
namespace {

std::vector<Vec3d> cube(double low, double high) {
  std::vector<Vec3d> corners;
  for (int i = 0; i < 8; ++i)
    corners.emplace_back(i & 1 ? high : low, i & 2 ? high : low, i & 4 ? high : low);
  return corners;
}

Vec3d drawn(RandomStream& random, double low, double high) {
  Vec3d p;
  for (double& c : p) c = random.uniform(low, high);
  return p;
}

TEST(ConvexPolytope, OfACubeTheNearestPointIsTheClampedOne) {
  std::vector<Vec3d> points = cube(-1, 2);
  RandomStream random(3, "points of a cube", 0);
  for (int i = 0; i < 50; ++i) points.push_back(drawn(random, -1, 2));
  points.emplace_back(0.5, 0.5, 2);  // on a side, on an edge, and a corner twice
  points.emplace_back(0.5, 2, 2);
  points.push_back(points[0]);
  const auto solid = ConvexPolytope::hull(points);
  ASSERT_TRUE(solid);
  EXPECT_EQ(solid->corners(), cube(-1, 2));
  for (int i = 0; i < 2000; ++i) {
    const Vec3d p = drawn(random, -4, 5), clamped = p.cwiseMax(-1.0).cwiseMin(2.0);
    EXPECT_LT((solid->nearest(p) - clamped).norm(), 1e-14);
    EXPECT_EQ(solid->outside(p) <= 0, p == clamped);
    if (p == clamped) {
      EXPECT_EQ(solid->nearest(p), p);
    }
  }
}

// The nearest point x of a convex set is the one with (p − x) · (c − x) ≤ 0 for all its points c.
TEST(ConvexPolytope, TheNearestPointOfAnyHullMeetsTheVariationalInequality) {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    RandomStream random(seed, "points of a hull", 0);
    std::vector<Vec3d> points;
    for (int i = 0; i < 5 + static_cast<int>(seed) * 7; ++i) points.push_back(drawn(random, 0, 1));
    const auto solid = ConvexPolytope::hull(points);
    ASSERT_TRUE(solid);
    for (const Vec3d& p : points) EXPECT_LE(solid->outside(p), 1e-10);
    for (int i = 0; i < 300; ++i) {
      const Vec3d p = drawn(random, -1, 2), x = solid->nearest(p);
      EXPECT_LE(solid->outside(x), 1e-12);
      for (const Vec3d& c : points) EXPECT_LE((p - x).dot(c - x), 1e-12);
    }
  }
}

TEST(ConvexPolytope, OfASphereEveryPointIsACorner) {
  RandomStream random(5, "points of a sphere", 0);
  std::vector<Vec3d> points;
  for (int i = 0; i < 400; ++i)
    points.push_back(Vec3d(random.normal(), random.normal(), random.normal()).normalized());
  const auto solid = ConvexPolytope::hull(points);
  ASSERT_TRUE(solid);
  EXPECT_EQ(solid->corners().size(), points.size());
}

TEST(ConvexPolytope, TheBoxCutsOffWhatIsOutside) {
  const auto solid = ConvexPolytope::hull(cube(-1, 2));
  ASSERT_TRUE(solid);
  const auto cut = solid->within({Vec3d(0, -5, -5), Vec3d(1, 5, 5)});
  ASSERT_TRUE(cut);
  EXPECT_EQ(cut->nearest({3, 0, 0}), Vec3d(1, 0, 0));
  EXPECT_EQ(cut->nearest({-3, 0, 0}), Vec3d(0, 0, 0));
  EXPECT_LT((cut->nearest({0.5, 9, 0}) - Vec3d(0.5, 2, 0)).norm(), 1e-15);
  EXPECT_FALSE(solid->within({Vec3d(3, 3, 3), Vec3d(4, 4, 4)}));
  EXPECT_EQ(solid->within({Vec3d(-9, -9, -9), Vec3d(9, 9, 9)})->corners(), solid->corners());

  // For any hull: the nearest point of the clipped part is in both hulls, and no point of both is nearer.
  RandomStream random(8, "points of a hull", 1);
  std::vector<Vec3d> points;
  for (int i = 0; i < 30; ++i) points.push_back(drawn(random, -0.5, 1.5));
  const auto whole = ConvexPolytope::hull(points);
  const auto part = whole->within({Vec3d::Zero(), Vec3d::Ones()});
  ASSERT_TRUE(part);
  for (int i = 0; i < 300; ++i) {
    const Vec3d p = drawn(random, -1, 2), x = part->nearest(p), other = drawn(random, 0, 1);
    EXPECT_LE(whole->outside(x), 1e-12);
    EXPECT_GE(x.minCoeff(), -1e-12);
    EXPECT_LE(x.maxCoeff(), 1 + 1e-12);
    if (whole->outside(other) <= 0) {
      EXPECT_LE(part->outside(other), 1e-12);
      EXPECT_LE((p - x).dot(other - x), 1e-12);
    }
  }
}

TEST(ConvexPolytope, PointsWithoutVolumeHaveNone) {
  EXPECT_FALSE(ConvexPolytope::hull({}));
  EXPECT_FALSE(ConvexPolytope::hull(std::vector<Vec3d>(9, Vec3d(1, 2, 3))));
  std::vector<Vec3d> plane = cube(0, 1);
  for (Vec3d& p : plane) p.z() = p.x() + p.y();
  EXPECT_FALSE(ConvexPolytope::hull(plane));
  std::vector<Vec3d> wild = cube(0, 1);
  wild[3].y() = std::nan("");
  EXPECT_FALSE(ConvexPolytope::hull(wild));
  wild[3].y() = 1e300;
  EXPECT_FALSE(ConvexPolytope::hull(wild));
}

}  // namespace
}  // namespace mirage
