#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "base/random.h"
#include "geometry/mesh.h"
#include "geometry/solid.h"

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
  // A solid inside another touches nothing.
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
      return testing::Matches(testing::Contains(0))(sphere.faces[as_size(face)]);
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
                                 Vec3d{random.normal(), random.normal(), 1}.normalized());
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
    if (slab.vertices[as_size(face[0])].z() < 0 || slab.vertices[as_size(face[1])].z() < 0 ||
        slab.vertices[as_size(face[2])].z() < 0)
      continue;
    ++level;
    EXPECT_NEAR(found[f].thickness, 0.02, 1e-12);
  }
  EXPECT_GT(level, 50);
}

TEST(Walls, AnEdgeIsNoWall) {
  // A prism with a sharp edge along y: its two sides meet there, and count as thin only next to it.
  const double angle = 0.2, tip = std::tan(angle);
  Mesh wedge;
  wedge.vertices = {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {1, 1, 0}, {1, 0, tip}, {1, 1, tip}};
  wedge.faces = {{0, 1, 2}, {1, 3, 2}, {0, 4, 1}, {1, 4, 5}, {2, 3, 4}, {3, 5, 4}, {0, 2, 4}, {1, 5, 3}};
  ASSERT_TRUE(is_watertight(wedge));
  ASSERT_GT(signed_volume(wedge), 0);
  // From the lower side, a third of the way from the edge.
  EXPECT_NEAR(walls(wedge)[0].thickness, tip / 3, 1e-12);
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

TEST(WindingNumber, OneInsideAndZeroOutsideAClosedMesh) {
  const WindingNumber w(icosphere(3));
  RandomStream random(1, "winding");
  for (int i = 0; i < 300; ++i) {
    const Vec3d p{random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2)};
    if (std::abs(p.norm() - 1) < 0.02) continue;
    EXPECT_NEAR(w.at(p, true), p.norm() < 1, 1e-9);
    EXPECT_NEAR(w.at(p), p.norm() < 1, 0.03);
  }
}

TEST(WindingNumber, AHoleLeavesTheSignRight) {
  Mesh mesh = icosphere(3);
  // Cut away the cap over z = 0.8: one face in ten.
  std::erase_if(mesh.faces, [&](const Face& f) {
    return (mesh.vertices[as_size(f[0])] + mesh.vertices[as_size(f[1])] + mesh.vertices[as_size(f[2])]).z() >
           2.4;
  });
  ASSERT_FALSE(is_watertight(mesh));
  const WindingNumber w(mesh);
  RandomStream random(2, "winding");
  for (int i = 0; i < 300; ++i) {
    const Vec3d p{random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5)};
    if (std::abs(p.norm() - 1) < 0.05 || p.z() > 0.7) continue;
    EXPECT_EQ(w.at(p) > 0.5, p.norm() < 1) << p.transpose();
  }
  EXPECT_NEAR(w.at({0, 0, 0}), 0.9, 0.02);  // the cap's share of the sphere is (1 − 0.8) / 2
}

TEST(WindingNumber, OverlappingBodiesAndEmptyMeshes) {
  Mesh two = icosphere(2);
  append(two, icosphere(2), Transform(Eigen::Translation3d(0.5, 0, 0)));
  EXPECT_NEAR(WindingNumber(two).at({0.25, 0, 0}, true), 2, 1e-9);
  EXPECT_EQ(WindingNumber(Mesh{}).at({0, 0, 0}), 0);
  Mesh flat;
  flat.vertices = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  flat.faces = {{0, 1, 2}};
  EXPECT_EQ(WindingNumber(flat).at({1, 0, 0}), 0);
}

DistanceGrid sampled(const std::function<double(const Vec3d&)>& distance, int nodes, double half) {
  DistanceGrid grid;
  grid.layout = {Vec3d::Constant(-half), Vec3d::Constant(2 * half / (nodes - 1)), {nodes, nodes, nodes}};
  for (int k = 0; k < nodes; ++k)
    for (int j = 0; j < nodes; ++j)
      for (int i = 0; i < nodes; ++i)
        grid.values.push_back(static_cast<float>(distance(grid.layout.node(i, j, k))));
  return grid;
}

double torus(const Vec3d& p) {
  return Vec2d(p.head<2>().norm() - 1, p.z()).norm() - 0.4;
}

TEST(MarchingCubes, SphereIsClosedOutwardAndOnTheSurface) {
  const Mesh mesh = marching_cubes(sampled([](const Vec3d& p) { return p.norm() - 1; }, 33, 1.5));
  EXPECT_TRUE(is_watertight(mesh));
  const auto normals = face_normals(mesh);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    EXPECT_GT(normals[f].norm(), 0);
    EXPECT_GT(normals[f].dot(mesh.vertices[as_size(mesh.faces[f][0])]), 0);
  }
  for (const Vec3d& v : mesh.vertices) EXPECT_NEAR(v.norm(), 1, 2e-3);
  EXPECT_NEAR(signed_volume(mesh), 4 * std::numbers::pi / 3, 0.03);
  EXPECT_EQ(static_cast<long>(mesh.vertices.size()) * 2 - 4,
            static_cast<long>(mesh.faces.size()));  // genus 0
}

TEST(MarchingCubes, TorusHasItsHoleAndVolume) {
  const Mesh mesh = marching_cubes(sampled(torus, 41, 1.7));
  EXPECT_TRUE(is_watertight(mesh));
  EXPECT_NEAR(signed_volume(mesh), 2 * std::numbers::pi * std::numbers::pi * 0.16, 0.05);
  EXPECT_EQ(mesh.vertices.size() * 2, mesh.faces.size());  // genus 1: V − E + F = 0
  const auto normals = face_normals(mesh);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto& [a, b, c] = mesh.faces[f];
    const Vec3d middle =
        (mesh.vertices[as_size(a)] + mesh.vertices[as_size(b)] + mesh.vertices[as_size(c)]) / 3;
    EXPECT_GT(torus(middle + 0.05 * normals[f].normalized()), torus(middle));
  }
}

TEST(MarchingCubes, EveryCaseIsWatertight) {
  // White noise meets all 256 cases and every ambiguous face.
  RandomStream random(1, "marching cubes");
  for (int repeat = 0; repeat < 5; ++repeat) {
    const Mesh mesh = marching_cubes(sampled([&](const Vec3d&) { return random.normal(); }, 14, 1));
    EXPECT_TRUE(is_watertight(mesh));
    EXPECT_GT(signed_volume(mesh), 0);
  }
}

TEST(MarchingCubes, ABodyThatReachesTheBorderIsClosedThere) {
  const Mesh mesh = marching_cubes(sampled([](const Vec3d& p) { return p.x(); }, 9, 1));
  EXPECT_TRUE(is_watertight(mesh));
  EXPECT_GT(signed_volume(mesh), 0);
}

TEST(MarchingCubes, DegenerateFields) {
  EXPECT_TRUE(marching_cubes(sampled([](const Vec3d&) { return 1.0; }, 5, 1)).faces.empty());
  EXPECT_TRUE(marching_cubes(sampled([](const Vec3d&) { return 0.0; }, 5, 1)).faces.empty());
  // A surface exactly through nodes gives no empty triangle.
  const Mesh mesh =
      marching_cubes(sampled([](const Vec3d& p) { return p.cwiseAbs().maxCoeff() - 0.5; }, 9, 1));
  EXPECT_TRUE(is_watertight(mesh));
  for (const Vec3d& n : face_normals(mesh)) EXPECT_GT(n.norm(), 1e-9);
}

TEST(DistanceGrid, InterpolatesLinearFunctionsExactlyAndGoesOnOutside) {
  const DistanceGrid grid = sampled([](const Vec3d& p) { return 0.3 * p.x() - 0.2 * p.y() + p.z(); }, 5, 1);
  RandomStream random(2, "grid");
  for (int i = 0; i < 100; ++i) {
    const Vec3d p{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    EXPECT_NEAR(grid.at(p), 0.3 * p.x() - 0.2 * p.y() + p.z(), 1e-6);
    const GridCell cell = cell_at(grid.layout, p);
    Vec3d gradient = Vec3d::Zero();
    for (std::size_t c = 0; c < 8; ++c) gradient += cell.gradients[c] * grid.values[cell.nodes[c]];
    EXPECT_LT((gradient - Vec3d(0.3, -0.2, 1)).norm(), 1e-5);
    EXPECT_EQ(cell.outside, 0);
  }
  EXPECT_NEAR(grid.at({3, 0, 0}), 0.3 + 2, 1e-6);
}

}  // namespace
}  // namespace mirage
