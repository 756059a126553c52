#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "geometry/shapes.h"
#include "sensors/mesh_distance.h"
#include "support/files.h"

namespace mirage {
namespace {

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
    const Vec3d p(random.uniform(-4, 4), random.uniform(-3, 3), random.uniform(-2, 2));
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
