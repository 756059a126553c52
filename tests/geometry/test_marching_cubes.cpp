#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "base/random.h"
#include "geometry/marching_cubes.h"

namespace mirage {
namespace {

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
    EXPECT_GT(normals[f].dot(mesh.vertices[mesh.faces[f][0]]), 0);
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
    const Vec3d middle = (mesh.vertices[a] + mesh.vertices[b] + mesh.vertices[c]) / 3;
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
    const Vec3d p(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    EXPECT_NEAR(grid.at(p), 0.3 * p.x() - 0.2 * p.y() + p.z(), 1e-6);
    const GridCell cell = cell_at(grid.layout, p);
    Vec3d gradient = Vec3d::Zero();
    for (int c = 0; c < 8; ++c) gradient += cell.gradients[c] * grid.values[cell.nodes[c]];
    EXPECT_LT((gradient - Vec3d(0.3, -0.2, 1)).norm(), 1e-5);
    EXPECT_EQ(cell.outside, 0);
  }
  EXPECT_NEAR(grid.at({3, 0, 0}), 0.3 + 2, 1e-6);
}

}  // namespace
}  // namespace mirage
