#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/random.h"
#include "sensors/gloss.h"

namespace mirage {
namespace {

Vec3d random_direction(RandomStream& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized();
}

TEST(Gloss, FresnelAtItsEnds) {
  EXPECT_NEAR(fresnel(1), 0.04, 1e-12);
  EXPECT_NEAR(fresnel(0), 1, 1e-12);
  for (int i = 0; i < 100; ++i) EXPECT_GE(fresnel(i / 100.0), fresnel((i + 1) / 100.0));
}

TEST(Gloss, BothLobesAreReciprocalAndNothingComesFromBehind) {
  RandomStream random(1, "gloss");
  const Vec3d n = Vec3d::UnitZ();
  for (int i = 0; i < 1000; ++i) {
    const Vec3d l = random_direction(random), v = random_direction(random);
    if (l.z() <= 0 || v.z() <= 0) {
      EXPECT_EQ(specular_response(n, l, v), 0);
      EXPECT_EQ(diffuse_response(n, l, v), 1);
      continue;
    }
    EXPECT_NEAR(specular_response(n, l, v) / l.z(), specular_response(n, v, l) / v.z(),
                1e-9 / (l.z() * v.z()));
    EXPECT_NEAR(diffuse_response(n, l, v), diffuse_response(n, v, l), 1e-12);
  }
}

/// The normals that GGX gives project to the plane's own area: what D is normalised by. With G and F one, and
/// the camera square to the surface, the lobe is D/4 over its half vectors.
TEST(Gloss, HighlightAsByHand) {
  const Vec3d n = Vec3d::UnitZ();
  const double alpha = kRoughness * kRoughness;
  EXPECT_NEAR(specular_response(n, n, n), 0.04 / (4 * alpha * alpha), 1e-12);  // π D(n) F / 4
  // Disney's diffuse lobe: none of it square on; half and one and a half of roughness away at grazing angles.
  EXPECT_EQ(diffuse_response(n, n, n), 1);
  const Vec3d grazing = Vec3d(1, 0, 1e-9).normalized();
  EXPECT_NEAR(diffuse_response(n, grazing, grazing), 1.5 * 1.5, 1e-6);
  EXPECT_NEAR(diffuse_response(n, grazing, Vec3d(-1, 0, 1e-9).normalized()), 0.5 * 0.5, 1e-6);
}

TEST(Gloss, ManyAtOnceAreAsOneByOne) {
  RandomStream random(3, "gloss");
  std::vector<float> nl, nv, lv;
  for (int i = 0; i < 1003; ++i) {
    const Vec3d l = random_direction(random), v = random_direction(random);
    nl.push_back(static_cast<float>(l.z())), nv.push_back(static_cast<float>(v.z()));
    lv.push_back(static_cast<float>(l.dot(v)));
  }
  nl[0] = nv[1] = 0, lv[2] = -1;
  std::vector<float> many(nl.size(), -1);
  specular_response(nl, nv, lv, many);
  int lit = 0;
  for (std::size_t i = 0; i < many.size(); ++i) {
    const double one = specular_response(double{nl[i]}, double{nv[i]}, double{lv[i]});
    ASSERT_NEAR(many[i], one, 1e-5 * std::max(1.0, one)) << nl[i] << " " << nv[i] << " " << lv[i];
    lit += one > 0;
  }
  EXPECT_GT(lit, 200);
}

TEST(Gloss, AlbedoIsTheLobesIntegral) {
  RandomStream random(2, "furnace");
  for (const double cosine : {1.0, 0.7, 0.31, 0.12}) {
    const Vec3d v(std::sqrt(1 - cosine * cosine), 0, cosine);
    double sum = 0;
    const int count = 200000;
    for (int i = 0; i < count; ++i) {  // cosine-weighted, so that π f_s n·l / n·l is averaged
      const double r2 = random.uniform(), turn = 2 * M_PI * random.uniform();
      const Vec3d l(std::sqrt(r2) * std::cos(turn), std::sqrt(r2) * std::sin(turn), std::sqrt(1 - r2));
      if (l.z() > 0) sum += specular_response(Vec3d::UnitZ(), l, v) / l.z();
    }
    EXPECT_NEAR(specular_albedo(cosine) / (sum / count), 1, 0.03) << cosine;
    EXPECT_LT(specular_albedo(cosine), 1);
  }
  double even = 0;
  for (int i = 0; i < 1000; ++i) even += 2 * (i + 0.5) / 1000 * specular_albedo((i + 0.5) / 1000) / 1000;
  EXPECT_NEAR(even, 0.059,
              0.001);  // sampled: four million pairs of directions
}

}  // namespace
}  // namespace mirage
