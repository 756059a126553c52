#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "base/random.h"
#include "base/sizes.h"
#include "geometry/box.h"
#include "geometry/mesh.h"

namespace mirage {
namespace {

constexpr double kPi = std::numbers::pi;

BevBox random_box(RandomStream& random, double spread = 4) {
  return {random.uniform(-spread, spread), random.uniform(-spread, spread), random.uniform(0.5, 6),
          random.uniform(0.5, 3), random.uniform(-2 * kPi, 2 * kPi)};
}

bool inside(const BevBox& box, double x, double y) {
  const double c = std::cos(box.yaw), s = std::sin(box.yaw), dx = x - box.x, dy = y - box.y;
  return std::abs(c * dx + s * dy) <= box.length / 2 && std::abs(c * dy - s * dx) <= box.width / 2;
}

TEST(BoxIou, ByHand) {
  EXPECT_DOUBLE_EQ(iou(BevBox{0, 0, 4, 2, 0}, BevBox{0, 0, 4, 2, 0}), 1);
  EXPECT_NEAR(iou(BevBox{0, 0, 4, 2, 0}, BevBox{2, 0, 4, 2, 0}), 1.0 / 3, 1e-12);
  EXPECT_NEAR(iou(BevBox{0, 0, 2, 2, 0}, BevBox{0, 0, 2, 2, kPi / 4}), 0.7071067811865476, 1e-12);  // octagon
  EXPECT_EQ(iou(BevBox{0, 0, 4, 2, 0}, BevBox{10, 0, 4, 2, 0}), 0);
  EXPECT_NEAR(iou(BevBox{0, 0, 4, 2, 0}, BevBox{4, 0, 4, 2, 0}), 0, 1e-12);  // edge to edge
  EXPECT_NEAR(iou(BevBox{0, 0, 6, 6, 0.3}, BevBox{0, 0, 2, 3, 1.1}), 6.0 / 36, 1e-12);
  EXPECT_EQ(iou(BevBox{0, 0, 0, 2, 0}, BevBox{0, 0, 4, 2, 0}), 0);
  for (const BevBox& none : {BevBox{0, 0, -4, 2, 0}, BevBox{0, 0, 4, -2, 0}, BevBox{0, 0, -4, -2, 0}}) {
    EXPECT_EQ(iou(none, {0, 0, 4, 2, 0}), 0);  // two negative sides have a positive product
    EXPECT_EQ(iou({0, 0, 4, 2, 0}, none), 0);
    EXPECT_EQ(iou(none, none), 0);
    EXPECT_EQ(intersection_area(none, {0, 0, 4, 2, 0}), 0);
    EXPECT_EQ(intersection_area({0, 0, 4, 2, 0}, none), 0);
  }
}

TEST(Box3Iou, ByHand) {
  const Box3 a{{0, 0, 4, 2, 0}, 0, 2};
  EXPECT_DOUBLE_EQ(iou(a, a), 1);
  EXPECT_NEAR(iou(a, Box3{{0, 0, 4, 2, 0}, 1, 2}), 1.0 / 3, 1e-12);         // half of the height in common
  EXPECT_NEAR(iou(a, Box3{{2, 0, 4, 2, 0}, 1, 2}), 4.0 / (32 - 4), 1e-12);  // a quarter in common
  EXPECT_EQ(iou(a, Box3{{0, 0, 4, 2, 0}, 2, 2}), 0);                        // stacked
  EXPECT_EQ(iou(a, Box3{{10, 0, 4, 2, 0}, 0, 2}), 0);
  for (const Box3& none :
       {Box3{{0, 0, 4, 2, 0}, 0, 0}, Box3{{0, 0, 4, 2, 0}, 2, -2}, Box3{{0, 0, -4, 2, 0}, 0, 2}}) {
    EXPECT_EQ(iou(none, a), 0);
    EXPECT_EQ(iou(a, none), 0);
  }
}

TEST(Box3Iou, AgreesWithCountedPoints) {
  RandomStream random(5, "box 3-D iou");
  constexpr int kPoints = 20000;
  int compared = 0;
  for (int i = 0; i < 40; ++i) {
    const Box3 a{random_box(random, 1.5), random.uniform(-1, 1), random.uniform(0.5, 2)},
        b{random_box(random, 1.5), random.uniform(-1, 1), random.uniform(0.5, 2)};
    int in_both = 0, in_any = 0;
    for (int k = 0; k < kPoints; ++k) {  // the boxes lie within 1.5 + 3.4 m of the middle
      const Vec3d p{random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(-1, 3)};
      const bool in_a = contains(a, p), in_b = contains(b, p);
      in_both += in_a && in_b, in_any += in_a || in_b;
    }
    if (in_any < 100) continue;  // two small boxes
    ++compared;
    // Of n points in the union a share p is in both, with the standard deviation √(p (1 − p) / n).
    const double share = static_cast<double>(in_both) / in_any, exact = iou(a, b);
    EXPECT_NEAR(share, exact, 5 * std::sqrt((exact * (1 - exact) + 1e-3) / in_any)) << i;
  }
  EXPECT_GT(compared, 30);
}

TEST(BoxIou, SymmetricBoundedAndBlindToRigidMotionAndHalfTurns) {
  RandomStream random(1, "box iou");
  for (int i = 0; i < 3000; ++i) {
    const BevBox a = random_box(random), b = random_box(random);
    const double value = iou(a, b);
    EXPECT_GE(value, 0);
    EXPECT_LE(value, 1);
    EXPECT_NEAR(value, iou(b, a), 1e-11);
    EXPECT_NEAR(iou(a, a), 1, 1e-11);
    BevBox turned = b;
    turned.yaw += kPi;
    EXPECT_NEAR(value, iou(a, turned), 1e-10);
    const double angle = random.uniform(-kPi, kPi), dx = random.uniform(-900, 900),
                 dy = random.uniform(-900, 900);
    const auto moved = [&](const BevBox& box) {
      return BevBox{std::cos(angle) * box.x - std::sin(angle) * box.y + dx,
                    std::sin(angle) * box.x + std::cos(angle) * box.y + dy, box.length, box.width,
                    box.yaw + angle};
    };
    EXPECT_NEAR(value, iou(moved(a), moved(b)), 1e-9);
    EXPECT_LE(intersection_area(a, b), std::min(a.length * a.width, b.length * b.width) + 1e-9);
  }
}

TEST(BoxIou, AgreesWithMonteCarlo) {
  RandomStream random(2, "box monte carlo");
  for (int i = 0; i < 40; ++i) {
    const BevBox a = random_box(random, 1.5), b = random_box(random, 1.5);
    constexpr int n = 20000;
    int hits = 0;
    for (int k = 0; k < n; ++k) {
      const double s = random.uniform(-0.5, 0.5) * a.length, t = random.uniform(-0.5, 0.5) * a.width;
      hits += inside(b, a.x + std::cos(a.yaw) * s - std::sin(a.yaw) * t,
                     a.y + std::sin(a.yaw) * s + std::cos(a.yaw) * t);
    }
    const double area = a.length * a.width;
    EXPECT_NEAR(intersection_area(a, b), area * hits / n, 5 * area * 0.5 / std::sqrt(n));
  }
}

TEST(Box3, CornersAndContainment) {
  const Box3 box{{10, 2, 4, 2, kPi / 2}, -1.5, 1.4};
  const auto c = corners(box);
  EXPECT_TRUE(c[0].isApprox(Vec3d(9, 4, -1.5), 1e-12)) << c[0];  // front left
  EXPECT_TRUE(c[4].isApprox(Vec3d(9, 4, -0.1), 1e-12));
  double twice = 0;
  for (std::size_t i = 0; i < 4; ++i) twice += c[i].x() * c[(i + 1) % 4].y() - c[i].y() * c[(i + 1) % 4].x();
  EXPECT_NEAR(twice / 2, 8, 1e-12);  // counter-clockwise
  EXPECT_TRUE(contains(box, Vec3d(10.9, 3.9, -0.2)));
  EXPECT_FALSE(contains(box, Vec3d(10.9, 3.9, 0)));
  EXPECT_TRUE(contains(box, Vec3d(10.9, 3.9, 0), 0.2));
  EXPECT_FALSE(contains(box, Vec3d(11.1, 3.9, -0.2)));
  EXPECT_TRUE((velo_from_box(box) * Vec3d(2, 1, 0)).isApprox(c[0], 1e-12));
}

TEST(PictureBox, OverlapByHand) {
  const PictureBox box{10, 20, 30, 30};
  EXPECT_DOUBLE_EQ(area(box), 200);
  EXPECT_DOUBLE_EQ(iou(box, box), 1);
  EXPECT_DOUBLE_EQ(intersection_area(box, {25, 15, 50, 25}), 25);
  EXPECT_DOUBLE_EQ(iou(box, {20, 20, 40, 30}), 1.0 / 3);
  EXPECT_DOUBLE_EQ(iou({20, 20, 40, 30}, box), 1.0 / 3);
  EXPECT_DOUBLE_EQ(iou(box, {15, 22, 20, 27}), 25.0 / 200);  // inside
  EXPECT_EQ(iou(box, {30, 20, 40, 30}), 0);                  // edge to edge
  EXPECT_EQ(iou(box, {40, 20, 50, 30}), 0);
  EXPECT_EQ(iou(box, {12, 25, 12, 28}), 0);        // no area
  EXPECT_EQ(area(PictureBox{30, 30, 10, 20}), 0);  // sides in the wrong order
  EXPECT_EQ(iou(box, {30, 30, 10, 20}), 0);
}

TEST(PictureBox, ItsRectangleOverlapsAsItDoes) {
  const PictureBox a{10, 20, 30, 30};
  for (const PictureBox& b :
       {PictureBox{20, 20, 40, 30}, PictureBox{15, 22, 20, 27}, PictureBox{5, 25, 28, 90},
        PictureBox{30, 20, 40, 30}, PictureBox{900, 20, 1200, 30}})
    EXPECT_NEAR(iou(rectangle(a), rectangle(b)), iou(a, b), 1e-12);
  EXPECT_EQ(rectangle(a).x, 20);
  EXPECT_EQ(rectangle(a).y, 25);
  EXPECT_EQ(rectangle(a).length, 20);
  EXPECT_EQ(rectangle(a).width, 10);
  EXPECT_EQ(picture_box(rectangle(a)).right, 30);
  EXPECT_EQ(picture_box(rectangle(a)).bottom, 30);
}

TEST(PictureBox, JoinedHoldsBoth) {
  const PictureBox both = united({10, 20, 30, 40}, {25, 5, 50, 30});
  EXPECT_EQ(both.left, 10);
  EXPECT_EQ(both.top, 5);
  EXPECT_EQ(both.right, 50);
  EXPECT_EQ(both.bottom, 40);
}

TEST(PictureBox, EndsAtThePicturesBorder) {
  const PictureBox cut = within({-26, 192, 379, 375.5}, 1242, 375);
  EXPECT_EQ(cut.left, 0);
  EXPECT_EQ(cut.top, 192);
  EXPECT_EQ(cut.right, 379);
  EXPECT_EQ(cut.bottom, 374);
  EXPECT_EQ(area(within({-30, 10, -5, 20}, 100, 50)), 0);
  EXPECT_EQ(area(within({110, 60, 140, 80}, 100, 50)), 0);
}

Vec3d area(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  return (b - a).cross(c - a) / 2;
}

/// Expects every triangle to be wound as the polygon, and their areas to sum to the polygon's: no overlaps or
/// gaps.
void expect_covers(const std::vector<Vec3d>& polygon, const Vec3d& whole) {
  const auto triangles = triangulate_polygon(polygon);
  ASSERT_EQ(triangles.size(), polygon.size() - 2);
  Vec3d sum = Vec3d::Zero();
  std::set<int> used;
  for (const auto& [a, b, c] : triangles) {
    const Vec3d part = area(polygon[as_size(a)], polygon[as_size(b)], polygon[as_size(c)]);
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
          Eigen::Quaterniond{random.normal(), random.normal(), random.normal(), random.normal()}
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
    const auto triangles = triangulate_polygon(polygon);
    EXPECT_EQ(triangles.size(), polygon.size() - 2);
    for (const auto& triangle : triangles) {
      EXPECT_NE(triangle[0], triangle[1]);
      for (const int corner : triangle) EXPECT_TRUE(corner >= 0 && corner < static_cast<int>(polygon.size()));
    }
  }
  EXPECT_TRUE(triangulate_polygon(std::vector<Vec3d>(2, Vec3d::Zero())).empty());
}

}  // namespace
}  // namespace mirage
