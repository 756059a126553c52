#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/random.h"
#include "geometry/self_intersection.h"
#include "geometry/shapes.h"

namespace mirage {
namespace {

Mesh joined(Mesh first, const Mesh& second) {
  const int offset = static_cast<int>(first.vertices.size());
  first.vertices.insert(first.vertices.end(), second.vertices.begin(), second.vertices.end());
  for (const Face& f : second.faces) first.faces.push_back({f[0] + offset, f[1] + offset, f[2] + offset});
  return first;
}

Mesh moved(Mesh mesh, const Vec3d& by) {
  for (Vec3d& v : mesh.vertices) v += by;
  return mesh;
}

TEST(SelfIntersection, ASphereHasNone) {
  EXPECT_TRUE(intersecting_faces(icosphere(2)).empty());
}

TEST(SelfIntersection, TwoSpheresCutEachOtherWhereTheyOverlapOnly) {
  const Mesh sphere = icosphere(1);
  const auto pairs = intersecting_faces(joined(sphere, moved(sphere, {1.3, 0.21, 0.13})));
  EXPECT_GE(pairs.size(), 6u);
  const int faces = static_cast<int>(sphere.faces.size());
  for (const auto& pair : pairs) {
    EXPECT_LT(pair[0], faces);
    EXPECT_GE(pair[1], faces);
  }
  EXPECT_TRUE(intersecting_faces(joined(sphere, moved(sphere, {2.1, 0, 0}))).empty());
  // One inside the other touches nothing.
  Mesh small = sphere;
  for (Vec3d& v : small.vertices) v *= 0.5;
  EXPECT_TRUE(intersecting_faces(joined(sphere, small)).empty());
}

TEST(SelfIntersection, AVertexPulledThroughTheOtherSideIsFound) {
  Mesh sphere = icosphere(2);
  sphere.vertices[0] *= -1.5;
  const auto pairs = intersecting_faces(sphere);
  ASSERT_FALSE(pairs.empty());
  for (const auto& pair : pairs) {
    const auto at_the_vertex = [&](int face) {
      return testing::Matches(testing::Contains(0))(sphere.faces[face]);
    };
    EXPECT_TRUE(at_the_vertex(pair[0]) || at_the_vertex(pair[1]));
  }
}

TEST(SelfIntersection, FacesFoldedOntoEachOtherCount) {
  Mesh sheet;
  sheet.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0.3, 0.3, 0}};
  sheet.faces = {{0, 1, 2}, {1, 0, 3}};
  EXPECT_EQ(intersecting_faces(sheet).size(), 1u);
  sheet.vertices[3] = {0.3, -0.5, 0};
  EXPECT_TRUE(intersecting_faces(sheet).empty());
}

TEST(SelfIntersection, DoesNotDependOnPlaceAndTurn) {
  RandomStream random(3, "turned spheres");
  for (int i = 0; i < 50; ++i) {
    Mesh mesh = icosphere(1);
    for (Vec3d& v : mesh.vertices) v *= random.uniform(0.1, 1);
    mesh.vertices[2] *= random.uniform(-2, 1);
    const std::size_t pairs = intersecting_faces(mesh).size();
    const Eigen::AngleAxisd turn(random.uniform(0, 6),
                                 Vec3d(random.normal(), random.normal(), 1).normalized());
    for (Vec3d& v : mesh.vertices) v = turn * v + Vec3d(40, -20, 3);
    EXPECT_EQ(intersecting_faces(mesh).size(), pairs) << i;
  }
}

TEST(Walls, OfASphereAreItsDiameterAndOfASlabItsHeight) {
  for (const Wall& wall : walls(icosphere(3))) {
    EXPECT_NEAR(wall.thickness, 2, 0.05);
    EXPECT_GE(wall.opposite, 0);
  }
  Mesh slab = icosphere(2);
  for (Vec3d& v : slab.vertices) v.z() = v.z() > 0.2 ? 0.01 : -0.01;
  const std::vector<Wall> found = walls(slab);
  int level = 0;
  for (std::size_t f = 0; f < found.size(); ++f) {
    const Face& face = slab.faces[f];
    if (slab.vertices[face[0]].z() < 0 || slab.vertices[face[1]].z() < 0 || slab.vertices[face[2]].z() < 0)
      continue;
    ++level;
    EXPECT_NEAR(found[f].thickness, 0.02, 1e-12);
  }
  EXPECT_GT(level, 50);
}

TEST(Walls, AnOpenMeshAndAFaceWithoutAreaHaveNone) {
  Mesh open;
  open.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  open.faces = {{0, 1, 2}, {0, 1, 1}};
  for (const Wall& wall : walls(open)) {
    EXPECT_TRUE(std::isinf(wall.thickness));
    EXPECT_EQ(wall.opposite, -1);
  }
}

}  // namespace
}  // namespace mirage
