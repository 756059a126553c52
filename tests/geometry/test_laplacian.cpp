#include <gtest/gtest.h>

#include "base/random.h"
#include "geometry/laplacian.h"
#include "geometry/shapes.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

TEST(Laplacian, GradientAgainstCentralDifferences) {
  Mesh mesh = icosphere(1);
  RandomStream random(1, "laplacian");
  std::vector<double> x;
  for (Vec3d& v : mesh.vertices)
    for (int c = 0; c < 3; ++c) x.push_back(v[c] += random.uniform(-.1, .1));
  const Laplacian laplacian(mesh);
  const auto energy = [&](const std::vector<double>& at) {
    std::vector<Vec3d> vertices, ignored(mesh.vertices.size(), Vec3d::Zero());
    for (std::size_t i = 0; i < at.size(); i += 3) vertices.push_back(Vec3d(at[i], at[i + 1], at[i + 2]));
    return laplacian.energy(vertices, 1, ignored);
  };
  std::vector<Vec3d> gradient(mesh.vertices.size(), Vec3d::Zero());
  laplacian.energy(mesh.vertices, 1, gradient);
  std::vector<double> flat;
  for (const Vec3d& d : gradient) flat.insert(flat.end(), d.data(), d.data() + 3);
  test::check_gradient(energy, x, flat, 1e-5, 1e-7);
}

TEST(Laplacian, AFlatRegularPatchCostsNothing) {
  Mesh fan;  // a centre and six neighbours
  fan.vertices.push_back(Vec3d::Zero());
  for (int k = 0; k < 6; ++k)
    fan.vertices.push_back(Vec3d(std::cos(k * M_PI / 3), std::sin(k * M_PI / 3), 0));
  for (int k = 0; k < 6; ++k) fan.faces.push_back({0, k + 1, (k + 1) % 6 + 1});
  std::vector<Vec3d> gradient(7, Vec3d::Zero());
  const double rim = Laplacian(fan).energy(fan.vertices, 1, gradient);
  fan.vertices[0].z() = 0.1;
  gradient.assign(7, Vec3d::Zero());
  EXPECT_GT(Laplacian(fan).energy(fan.vertices, 1, gradient), rim);
  EXPECT_GT(gradient[0].z(), 0);
}

}  // namespace
}  // namespace mirage
