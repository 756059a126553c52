#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "exchange/mesh_files.h"
#include "geometry/shapes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

Mesh wedge() {
  Mesh mesh = box_mesh({4, 1.8, 1.5});
  mesh.vertices[1].z() -= 0.3;  // tells the axes apart
  return mesh;
}

double furthest(const Mesh& a, const Mesh& b) {
  double worst = 0;
  for (const Vec3d& v : a.vertices) {
    double nearest = 1e9;
    for (const Vec3d& w : b.vertices) nearest = std::min(nearest, (v - w).norm());
    worst = std::max(worst, nearest);
  }
  return worst;
}

TEST(MeshFiles, WhatIsWrittenIsReadBack) {
  const test::TemporaryFolder folder;
  for (const auto& [name, axes] :
       {std::pair{"a.ply", MeshAxes{"+x", "+z"}}, std::pair{"a.glb", MeshAxes{"+x", "+y"}}}) {
    write_mesh(folder / name, wedge());
    const Mesh back = read_mesh(folder / name, axes);
    EXPECT_EQ(back.faces.size(), 12u) << name;
    EXPECT_LT(furthest(back, wedge()), 1e-6) << name;
    EXPECT_NEAR(signed_volume(back), signed_volume(wedge()), 1e-5) << name;
    EXPECT_TRUE(is_watertight(back)) << name;
  }
}

TEST(MeshFiles, ObjWithPolygonsAndOtherAxes) {
  const test::TemporaryFolder folder;
  // A box 1.8 × 1.5 × 4 that looks along −z with y up; one open side.
  write_file(folder / "car.obj",
             "v -0.9 0 -2\nv 0.9 0 -2\nv 0.9 0 2\nv -0.9 0 2\nv -0.9 1.5 -2\nv 0.9 1.5 -2\nv 0.9 1.5 2\nv "
             "-0.9 1.5 2\n"
             "f 1 2 3 4\nf 8 7 6 5\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nl 1 5\n");
  const Mesh mesh = read_mesh(folder / "car.obj", MeshAxes{"-z", "+y"});
  EXPECT_EQ(mesh.faces.size(), 10u);
  EXPECT_LT((bounds(mesh).sizes() - Vec3d(4, 1.8, 1.5)).norm(), 1e-6);
  EXPECT_FALSE(is_watertight(mesh));
  const auto samples = read_vehicle_meshes(folder.path(), MeshAxes{"-z", "+y"});
  ASSERT_EQ(samples.size(), 1u);
  EXPECT_EQ(samples[0].source, "user");
}

TEST(MeshFiles, ErrorsNameFileAndFix) {
  const test::TemporaryFolder folder;
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "none.ply"); }), HasSubstr("none.ply"));
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "a.stl"); }), HasSubstr("extension"));
  EXPECT_THAT(error_text<InputError>([&] { read_vehicle_meshes(folder.path()); }), HasSubstr("no meshes"));
  EXPECT_THAT(error_text<InputError>([&] { read_vehicle_meshes(folder / "none"); }),
              HasSubstr("not a folder"));
  EXPECT_THAT(error_text<InputError>([&] { write_mesh(folder / "a.stl", wedge()); }), HasSubstr("extension"));
  write_file(folder / "broken.ply", "ply\nformat ascii 1.0\nelement vertex 3\n");
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "broken.ply"); }), HasSubstr("broken.ply"));
  std::filesystem::remove(folder / "broken.ply");
  Mesh huge = wedge();
  for (Vec3d& v : huge.vertices) v *= 100;
  write_mesh(folder / "huge.ply", huge);
  EXPECT_THAT(error_text<InputError>([&] { read_vehicle_meshes(folder.path()); }),
              HasSubstr("400.00 m long"));
  EXPECT_THAT(error_text<InputError>([&] {
                read_mesh(folder / "huge.ply", MeshAxes{"+x", "-x"});
              }),
              HasSubstr("parallel"));
  EXPECT_THAT(error_text<InputError>([&] {
                read_mesh(folder / "huge.ply", MeshAxes{"x", "+z"});
              }),
              HasSubstr("no axis"));
}

}  // namespace
}  // namespace mirage
