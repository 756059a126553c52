#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "base/random.h"
#include "geometry/polygon.h"

namespace mirage {
namespace {

Vec3d area(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  return (b - a).cross(c - a) / 2;
}

/// Every triangle is wound as the polygon, and together they have its area: neither overlaps nor gaps, where
/// none is turned the other way.
void expect_covers(const std::vector<Vec3d>& polygon, const Vec3d& whole) {
  const auto triangles = cut_polygon(polygon);
  ASSERT_EQ(triangles.size(), polygon.size() - 2);
  Vec3d sum = Vec3d::Zero();
  std::set<int> used;
  for (const auto& [a, b, c] : triangles) {
    const Vec3d part = area(polygon[static_cast<std::size_t>(a)], polygon[static_cast<std::size_t>(b)],
                            polygon[static_cast<std::size_t>(c)]);
    EXPECT_GE(part.dot(whole), -1e-12 * whole.squaredNorm());
    sum += part;
    used.insert({a, b, c});
  }
  EXPECT_LT((sum - whole).norm(), 1e-9 * whole.norm());
  EXPECT_EQ(used.size(), polygon.size());
}

std::vector<Vec3d> placed(const std::vector<Vec2d>& plane, const Eigen::Matrix3d& turn) {
  std::vector<Vec3d> polygon;
  for (const Vec2d& p : plane) polygon.push_back(turn * Vec3d(p.x(), p.y(), 0) + Vec3d(3, -2, 1));
  return polygon;
}

double shoelace(const std::vector<Vec2d>& p) {
  double sum = 0;
  for (std::size_t i = 0; i < p.size(); ++i) {
    const Vec2d& next = p[(i + 1) % p.size()];
    sum += p[i].x() * next.y() - p[i].y() * next.x();
  }
  return sum / 2;
}

TEST(CutPolygon, CoversSimplePolygonsOfAnyShapeAndPlane) {
  RandomStream random(4, "polygons");
  std::vector<std::vector<Vec2d>> shapes = {
      {{0, 0}, {1, 0}, {1, 1}, {0, 1}},
      {{0, 0}, {4, 0}, {1, 1}, {0, 4}},                                  // an arrow
      {{0, 0}, {1, 0}, {2, 0}, {2, 2}, {1, 2}, {0, 2}},                  // corners on its edges
      {{0, 0}, {5, 0}, {5, 5}, {4, 5}, {4, 1}, {1, 1}, {1, 5}, {0, 5}},  // a U
      // A square with a square hole, by an edge there and back.
      {{0, 0}, {4, 0}, {4, 4}, {0, 4}, {0, 0}, {1, 1}, {1, 3}, {3, 3}, {3, 1}, {1, 1}}};
  for (int corners : {5, 12, 100}) {  // stars with arms of any length
    auto& star = shapes.emplace_back();
    for (int i = 0; i < corners; ++i) {
      const double angle = 2 * std::numbers::pi * i / corners, far = 0.1 + random.uniform();
      star.emplace_back(far * std::cos(angle), far * std::sin(angle));
    }
  }
  auto& spiral = shapes.emplace_back();  // few ears, and many corners that turn right
  for (int i = 0; i <= 200; ++i)
    spiral.emplace_back((1 + 0.05 * i) * std::cos(0.2 * i), (1 + 0.05 * i) * std::sin(0.2 * i));
  for (int i = 200; i >= 0; --i)
    spiral.emplace_back((1.5 + 0.05 * i) * std::cos(0.2 * i), (1.5 + 0.05 * i) * std::sin(0.2 * i));
  for (std::size_t s = 0; s < shapes.size(); ++s)
    for (int k = 0; k < 8; ++k) {
      SCOPED_TRACE(s);
      const Eigen::Matrix3d turn =
          Eigen::Quaterniond(random.normal(), random.normal(), random.normal(), random.normal())
              .normalized()
              .toRotationMatrix();
      std::vector<Vec2d> shape = shapes[s];
      if (k % 2 == 1) std::reverse(shape.begin(), shape.end());
      expect_covers(placed(shape, turn), turn.col(2) * shoelace(shape));
    }
}

TEST(CutPolygon, WhatHasNoTrianglesIsCutAllTheSame) {
  const std::vector<Vec3d> point(7, Vec3d(1, 2, 3)), line = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}};
  const std::vector<Vec3d> bow = {{0, 0, 0}, {1, 1, 0}, {1, 0, 0}, {0, 1, 0}, {0.5, 3, 0}};
  for (const auto& polygon : {point, line, bow}) {
    const auto triangles = cut_polygon(polygon);
    EXPECT_EQ(triangles.size(), polygon.size() - 2);
    for (const auto& triangle : triangles) {
      EXPECT_NE(triangle[0], triangle[1]);
      for (const int corner : triangle) EXPECT_TRUE(corner >= 0 && corner < static_cast<int>(polygon.size()));
    }
  }
  EXPECT_TRUE(cut_polygon(std::vector<Vec3d>(2, Vec3d::Zero())).empty());
}

}  // namespace
}  // namespace mirage
