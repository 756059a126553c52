// Rectangles around the visible part of a thing.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "base/types.h"
#include "geometry/box.h"

namespace mirage {
namespace {

/// Points 5 cm apart on the two sides of a box that face the unit.
std::vector<Vec2d> seen_sides(const BevBox& box) {
  std::vector<Vec2d> places;
  const auto all = corners(box);
  std::size_t nearest = 0;
  for (std::size_t k = 1; k < 4; ++k)
    if (all[k].norm() < all[nearest].norm()) nearest = k;
  for (const std::size_t other : {(nearest + 1) % 4, (nearest + 3) % 4}) {
    const Vec2d way = all[other] - all[nearest];
    for (double at = 0; at <= way.norm(); at += 0.05)
      places.emplace_back(all[nearest] + at / way.norm() * way);
  }
  return places;
}

TEST(SeenRectangle, HasHeadingAndSizeOfACornerThatIsSeen) {
  for (const double yaw : {0.2, 0.7, 1.3, 2.2, -0.9}) {
    const BevBox box{14, 4, 4.2, 1.8, yaw};
    const BevBox found = closest_rectangle(seen_sides(box)).box();
    const double turned = std::remainder(found.yaw - yaw, std::numbers::pi / 2);
    EXPECT_LT(std::abs(turned), 1.01 * kDegree) << yaw;  // headings are 2° apart
    EXPECT_NEAR(std::max(found.length, found.width), 4.2, 0.1) << yaw;
    EXPECT_NEAR(std::min(found.length, found.width), 1.8, 0.1) << yaw;
    EXPECT_GT(iou(found, box), 0.9) << yaw;
  }
}

TEST(SeenRectangle, GrowsAwayFromTheUnit) {
  EXPECT_EQ((SeenSide{5, 6}.grown(3).high), 8);
  EXPECT_EQ((SeenSide{-6, -5}.grown(3).low), -8);
  EXPECT_EQ((SeenSide{5, 9}.grown(3).high), 9);
  EXPECT_EQ((SeenSide{5, 9}.sized(3).high), 8);
}

TEST(SeenRectangle, ShowsACarOrNone) {
  const auto rear = car_seen_as({0, {20, 20.1}, {-0.8, 0.8}});  // the car's length extends behind the points
  ASSERT_TRUE(rear);
  EXPECT_NEAR(rear->x, 20 + 3.9 / 2, 1e-9);
  EXPECT_NEAR(rear->length, 3.9, 1e-9);
  const auto side = car_seen_as({0, {20, 20.2}, {-2, 2}});
  ASSERT_TRUE(side);
  EXPECT_NEAR(std::abs(std::sin(side->yaw)), 1, 1e-9);
  EXPECT_NEAR(side->length, 4, 1e-9);
  EXPECT_FALSE(car_seen_as({0, {20, 20.5}, {-0.2, 0.3}}));  // a post
  EXPECT_FALSE(car_seen_as({0, {20, 23}, {-3, 3}}));        // a lorry
}

}  // namespace
}  // namespace mirage
