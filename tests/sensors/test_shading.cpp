#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/error.h"
#include "base/random.h"
#include "geometry/mesh.h"
#include "sensors/lighting.h"
#include "sensors/material.h"
#include "sensors/ray_caster.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

TEST(Shading, KnownValues) {
  Lighting light;
  light.to_sun_velo = Vec3d::UnitZ();
  light.sun = Vec3d(0.5, 0.4, 0.3);
  light.ambient = Vec3d(0.1, 0.1, 0.1);
  light.hemisphere = Vec3d(0.2, 0.2, 0.4);
  EXPECT_LT((shade(Vec3d(0, 0, 7), light) - Vec3d(0.8, 0.7, 0.8)).norm(), 1e-12);   // up
  EXPECT_LT((shade(Vec3d(0, 0, -2), light) - Vec3d(0.1, 0.1, 0.1)).norm(), 1e-12);  // down
  EXPECT_LT((shade(Vec3d(3, 0, 0), light) - Vec3d(0.2, 0.2, 0.3)).norm(), 1e-12);   // sideways
  EXPECT_LT((shade(Vec3d::Zero(), light) - light.ambient).norm(), 1e-12);           // no area
}

TEST(Shading, GradientAgainstCentralDifferences) {
  const Lighting light;
  const Vec3d d_factor(0.3, -1.1, 0.7);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    RandomStream random(seed, "normal");
    const std::vector<double> n{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    const auto at = [](const std::vector<double>& x) { return Vec3d(x[0], x[1], x[2]); };
    const Vec3d gradient = shade_vjp(at(n), light, d_factor);
    test::check_gradient([&](const auto& x) { return d_factor.dot(shade(at(x), light)); }, n,
                         {gradient.x(), gradient.y(), gradient.z()}, 1e-6, 1e-7);
  }
  EXPECT_TRUE(shade_vjp(Vec3d::Zero(), light, d_factor).isZero());
}

Vec3d random_direction(RandomStream& random) {
  return Vec3d{random.normal(), random.normal(), random.normal()}.normalized();
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

/// The projected area of GGX's normals is the plane's area, which normalises D. With G and F one, and the
/// camera perpendicular to the surface, the lobe is D/4 over its half vectors.
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

TEST(MeshDistance, SphereAgainstTheAnalyticDistance) {
  const Mesh sphere = icosphere(5);
  const GridLayout layout{Vec3d::Constant(-1.5), Vec3d::Constant(0.25), {13, 13, 13}};
  const DistanceGrid grid = distance_grid(sphere, layout);
  for (int k = 0; k < 13; ++k)
    for (int j = 0; j < 13; ++j)
      for (int i = 0; i < 13; ++i)
        EXPECT_NEAR(grid.values[layout.index(i, j, k)], layout.node(i, j, k).norm() - 1, 1e-3);
}

TEST(MeshDistance, BoxAgainstTheAnalyticDistance) {
  const MeshDistance distance(box_mesh({4, 2, 1}));
  RandomStream random(1, "mesh distance");
  for (int i = 0; i < 500; ++i) {
    const Vec3d p{random.uniform(-4, 4), random.uniform(-3, 3), random.uniform(-2, 2)};
    const Vec3d q = p.cwiseAbs() - Vec3d(2, 1, 0.5);
    const double expected = q.cwiseMax(0).norm() + std::min(0.0, q.maxCoeff());
    EXPECT_NEAR(distance.signed_distance(p), expected, 1e-5);
  }
}

TEST(MeshDistance, OpenAndInsideOutMeshesKeepTheirSign) {
  Mesh mesh = icosphere(3);
  mesh.faces.resize(mesh.faces.size() - 20);
  const MeshDistance open(mesh);
  for (Face& f : mesh.faces) std::swap(f[1], f[2]);
  const MeshDistance reversed(mesh);
  for (const MeshDistance* d : {&open, &reversed}) {
    EXPECT_LT(d->signed_distance({0.1, 0, 0}), 0);
    EXPECT_GT(d->signed_distance({0, 0, 1.6}), 0);
    EXPECT_GT(d->signed_distance({0, -1.6, 0}), 0);
  }
}

TEST(MeshDistance, DegenerateFacesAndNoFaces) {
  Mesh mesh = box_mesh({2, 2, 2});
  mesh.faces.push_back({0, 0, 1});
  mesh.faces.push_back({3, 3, 3});
  EXPECT_NEAR(MeshDistance(mesh).signed_distance({0, 0, 3}), 2, 1e-6);
  EXPECT_NE(test::error_text<InputError>([] { MeshDistance{Mesh{}}; }).find("faces"), std::string::npos);
}

}  // namespace
}  // namespace mirage
