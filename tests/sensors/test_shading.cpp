#include <gtest/gtest.h>

#include "base/random.h"
#include "sensors/shading.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

TEST(Shading, KnownValues) {
  Lighting light;
  light.to_sun_velo = Vec3d::UnitZ();
  light.sun = Vec3d(0.5, 0.4, 0.3);
  light.ambient = Vec3d(0.1, 0.1, 0.1);
  light.hemisphere = Vec3d(0.2, 0.2, 0.4);
  EXPECT_LT((shade<double>(Vec3d(0, 0, 7), light) - Vec3d(0.8, 0.7, 0.8)).norm(), 1e-12);   // up
  EXPECT_LT((shade<double>(Vec3d(0, 0, -2), light) - Vec3d(0.1, 0.1, 0.1)).norm(), 1e-12);  // down
  EXPECT_LT((shade<double>(Vec3d(3, 0, 0), light) - Vec3d(0.2, 0.2, 0.3)).norm(), 1e-12);   // sideways
  EXPECT_LT((shade<double>(Vec3d::Zero(), light) - light.ambient).norm(), 1e-12);           // no area
}

TEST(Shading, GradientAgainstCentralDifferences) {
  const Lighting light;
  const Vec3d d_factor(0.3, -1.1, 0.7);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    RandomStream random(seed, "normal");
    const std::vector<double> n{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    const auto at = [](const std::vector<double>& x) { return Vec3d(x[0], x[1], x[2]); };
    const Vec3d gradient = shade_vjp<double>(at(n), light, d_factor);
    test::check_gradient([&](const auto& x) { return d_factor.dot(shade<double>(at(x), light)); }, n,
                         {gradient.x(), gradient.y(), gradient.z()}, 1e-6, 1e-7);
  }
  EXPECT_TRUE(shade_vjp<double>(Vec3d::Zero(), light, d_factor).isZero());
}

}  // namespace
}  // namespace mirage
