#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <numbers>

#include "base/error.h"
#include "base/random.h"
#include "geometry/mesh.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

void expect_outward(const Mesh& mesh) {
  const auto normals = face_normals(mesh);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto& [a, b, c] = mesh.faces[f];
    EXPECT_GT(
        normals[f].dot(mesh.vertices[as_size(a)] + mesh.vertices[as_size(b)] + mesh.vertices[as_size(c)]), 0)
        << f;
  }
}

TEST(Icosphere, AdversarysStart) {
  const Mesh mesh = icosphere(2);
  EXPECT_EQ(mesh.vertices.size(), 162u);
  EXPECT_EQ(mesh.faces.size(), 320u);
}

TEST(Icosphere, EveryLevelIsAClosedOutwardUnitSphere) {
  double before = 0;
  for (int level = 0; level <= 4; ++level) {
    const Mesh mesh = icosphere(level);
    EXPECT_EQ(mesh.vertices.size(), 10u * (1u << (2 * level)) + 2);
    EXPECT_EQ(mesh.faces.size(), 20u * (1u << (2 * level)));
    EXPECT_TRUE(is_watertight(mesh));
    for (const Vec3d& v : mesh.vertices) EXPECT_NEAR(v.norm(), 1, 1e-14);
    expect_outward(mesh);
    const double volume = signed_volume(mesh);
    EXPECT_GT(volume, before);
    EXPECT_LT(volume, 4 * std::numbers::pi / 3);
    before = volume;
  }
  EXPECT_NEAR(before, 4 * std::numbers::pi / 3, 0.02);
}

TEST(BoxMesh, ClosedOutwardAndOfItsSize) {
  const Mesh mesh = box_mesh({4, 1.8, 1.5});
  EXPECT_EQ(mesh.vertices.size(), 8u);
  EXPECT_EQ(mesh.faces.size(), 12u);
  EXPECT_TRUE(is_watertight(mesh));
  expect_outward(mesh);
  EXPECT_NEAR(signed_volume(mesh), 4 * 1.8 * 1.5, 1e-12);
  EXPECT_TRUE(bounds(mesh).min().isApprox(Vec3d(-2, -0.9, -0.75)));
  EXPECT_TRUE(bounds(mesh).max().isApprox(Vec3d(2, 0.9, 0.75)));
}

TEST(Bounds, AreOfTheVerticesThatFacesUse) {
  Mesh mesh = box_mesh({4, 1.8, 1.5});
  const Eigen::AlignedBox3d own = bounds(mesh);
  mesh.vertices.insert(mesh.vertices.begin(), Vec3d(0, 0, -900));
  mesh.vertices.emplace_back(900, 900, 900);
  for (Face& f : mesh.faces)
    for (int& corner : f) ++corner;
  EXPECT_EQ(bounds(mesh).min(), own.min());
  EXPECT_EQ(bounds(mesh).max(), own.max());
  EXPECT_EQ(used_vertices(mesh), (std::vector<std::size_t>{1, 2, 3, 4, 5, 6, 7, 8}));
  mesh.faces.clear();
  EXPECT_EQ(bounds(mesh).min(), Vec3d::Zero());
  EXPECT_EQ(bounds(mesh).max(), Vec3d::Zero());
  EXPECT_TRUE(used_vertices(mesh).empty());
}

TEST(Append, KeepsBothPartsClosed) {
  Mesh mesh = box_mesh({1, 1, 1});
  Transform aside = Transform::Identity();
  aside.translation() = Vec3d(5, 0, 0);
  append(mesh, icosphere(1), aside);
  EXPECT_TRUE(is_watertight(mesh));
  EXPECT_NEAR(signed_volume(mesh), 1 + signed_volume(icosphere(1)), 1e-12);
  EXPECT_NEAR(bounds(mesh).max().x(), 6, 0.1);
}

TEST(Mesh, OpenOrInconsistentMeshIsNotWatertight) {
  Mesh open = icosphere(1);
  open.faces.pop_back();
  EXPECT_FALSE(is_watertight(open));
  Mesh flipped = icosphere(1);
  std::swap(flipped.faces[3][0], flipped.faces[3][1]);
  EXPECT_FALSE(is_watertight(flipped));
  EXPECT_FALSE(is_watertight({}));
}

TEST(CheckMesh, NamesWhatIsWrong) {
  const auto text = [](const TexturedMesh& mesh) -> std::string {
    try {
      check_mesh(mesh, "mesh.glb");
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  TexturedMesh mesh{icosphere(0), {2, std::vector<Vec3d>(80, Vec3d::Zero())}};
  EXPECT_EQ(text(mesh), "");
  EXPECT_EQ(text({icosphere(0), {}}), "");
  TexturedMesh bad = mesh;
  bad.mesh.faces[4][1] = 12;
  EXPECT_THAT(text(bad), testing::HasSubstr("mesh.glb: face 4"));
  bad = mesh;
  bad.mesh.vertices[3].y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(text(bad), testing::HasSubstr("vertex 3"));
  bad = mesh;
  bad.atlas.texels.pop_back();
  EXPECT_THAT(text(bad), testing::HasSubstr("79 for 20 faces"));
  bad = mesh;
  bad.atlas.texels[7].x() = std::numeric_limits<double>::infinity();
  EXPECT_THAT(text(bad), testing::HasSubstr("texel 7"));
}

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
