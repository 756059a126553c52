#include <gtest/gtest.h>

#include <cmath>

#include "scene/carrier.h"

namespace mirage {
namespace {

TEST(BoxRoofFinder, StandsOnTheTopFaceBehindTheCentreAlongTheHeading) {
  Label label;
  label.type = "Car";
  label.box = {{20, -4, 4, 1.8, 0.7}, -1.7, 1.5};
  const Carrier carrier = BoxRoofFinder().find({}, label);
  const Transform& pose = carrier.velo_from_roof;
  EXPECT_TRUE(carrier.from_box);
  EXPECT_TRUE((pose.linear() * Vec3d::UnitX()).isApprox(Vec3d(std::cos(0.7), std::sin(0.7), 0), 1e-12));
  EXPECT_TRUE((pose.linear() * Vec3d::UnitZ()).isApprox(Vec3d::UnitZ(), 1e-12));
  EXPECT_NEAR(pose.linear().determinant(), 1, 1e-12);
  const Vec3d p_box = velo_from_box(label.box).inverse() * pose.translation();
  EXPECT_NEAR(p_box.z(), 1.5, 1e-12);
  EXPECT_NEAR(p_box.y(), 0, 1e-12);
  EXPECT_LT(p_box.x(), 0);
  EXPECT_GT(p_box.x(), -0.15 * 4);
  EXPECT_TRUE(contains(label.box, pose.translation(), 1e-9));
}

}  // namespace
}  // namespace mirage
