#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <sstream>
#include <string>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/random.h"
#include "base/sizes.h"
#include "exchange/mesh_files.h"
#include "exchange/polygons.h"
#include "geometry/mesh.h"
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

TEST(MeshFiles, AMeshIsReadByItsContentAndWrittenByItsEndingInAnyCase) {
  const test::TemporaryFolder folder;
  TexturedMesh mesh = grey_ellipsoid({0.6, 0.5, 0.4});
  RandomStream random(1, "texels");
  for (Vec3d& t : mesh.atlas.texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  for (const char* name : {"a.glb", "A.GLB"}) {
    write_textured_mesh(folder / name, mesh);
    for (const char* as : {"b.glb", "b.GLTF", "b.obj", "b"}) {
      std::filesystem::copy_file(folder / name, folder / as,
                                 std::filesystem::copy_options::overwrite_existing);
      const TexturedMesh back = read_textured_mesh(folder / as);
      EXPECT_EQ(back.mesh.vertices, mesh.mesh.vertices) << as;
      EXPECT_EQ(back.mesh.faces, mesh.mesh.faces) << as;
      EXPECT_EQ(back.atlas.texels, mesh.atlas.texels) << as;
    }
  }
  for (const char* name : {"a.ply", "A.PLY", "a.obj", "A.Obj"}) {
    write_textured_mesh(folder / name, mesh);
    std::filesystem::copy_file(folder / name, folder / "b.glb",
                               std::filesystem::copy_options::overwrite_existing);
    const TexturedMesh back = read_textured_mesh(folder / "b.glb");
    EXPECT_LT((bounds(back.mesh).sizes() - bounds(mesh.mesh).sizes()).norm(), 1e-6) << name;
    EXPECT_EQ(back.atlas.texels.size(), back.mesh.faces.size() * back.atlas.per_face()) << name;
  }
  for (const char* name : {"a.gltf", "a.stl", "a"})
    EXPECT_THAT(error_text<InputError>([&] { write_textured_mesh(folder / name, mesh); }),
                HasSubstr("give .glb, .obj or .ply"))
        << name;
}

TEST(MeshFiles, AnObjectOfNoRoofIsRefusedWithItsSizeAndUnit) {
  const test::TemporaryFolder folder;
  const auto refusal = [&](double scale, const Vec3d& shift = Vec3d::Zero()) {
    Mesh mesh = box_mesh(scale * Vec3d(1, 0.8, 0.5));
    for (Vec3d& v : mesh.vertices) v += shift;
    write_mesh(folder / "a.ply", mesh);
    return error_text<InputError>([&] { read_object(folder / "a.ply"); });
  };
  EXPECT_THAT(refusal(1000), HasSubstr("a.ply: size: 1000 × 800 × 500 m is not an object"));
  EXPECT_THAT(refusal(1000), HasSubstr("are these millimetres? scale by 0.001"));
  EXPECT_THAT(refusal(120), HasSubstr("are these centimetres? scale by 0.01"));
  EXPECT_THAT(refusal(0.001), HasSubstr("scale by 1000"));
  EXPECT_THAT(refusal(1, {30, -12, 0}), HasSubstr("a.ply: place: lies"));
  EXPECT_THAT(refusal(60), HasSubstr("a whole scene is not an object"));
  for (const double scale : {0.05, 1.0, 9.9}) {
    write_mesh(folder / "a.ply", box_mesh(scale * Vec3d(1, 0.8, 0.5)));
    EXPECT_EQ(read_object(folder / "a.ply").mesh.faces.size(), 12u) << scale;
  }
}

TEST(MeshFiles, AByteOrderMarkSpoilsNoRow) {
  const test::TemporaryFolder folder;
  write_file(folder / "a.obj", "\xEF\xBB\xBFv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  EXPECT_EQ(read_mesh(folder / "a.obj").faces.size(), 1u);
}

TEST(MeshFiles, ATextPlysRowEndsWhereItsLineEnds) {
  const test::TemporaryFolder folder;
  const auto read = [&](const std::string& body) {
    write_file(
        folder / "a.ply",
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n" +
            body);
    return read_mesh(folder / "a.ply").faces.size();
  };
  EXPECT_EQ(read("0 0 0\n1 0 0 \r\n\n0 1 0\n\t1 1 1\n3 0 1 2\n3 1 3 2\n\n"), 2u);
  EXPECT_EQ(read("0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 0 1 2\n3 1 3 2"), 2u);
  for (const auto& [body, line] :
       {std::pair{"0 0 0\n1 0\n0 1 0\n1 1 1\n3 0 1 2\n3 1 3 2\n", "line 11: has fewer values"},
        std::pair{"0 0 0\n1 0 0 0.5\n0 1 0\n1 1 1\n3 0 1 2\n3 1 3 2\n", "line 11: has more values"},
        std::pair{"0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 0 1 2 0.7\n3 1 3 2\n", "line 14: has more values"},
        std::pair{"0 0 0\n1 0 0\n0 1 0\n1 1 1\n4 0 1 2\n3 1 3 2\n", "line 14: has fewer values"},
        std::pair{"0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 0 1 2\n3 1 x 2\n", "line 15: holds a word"},
        std::pair{"0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 0 1 2\n3 1 3 2\n3 0 1 3\n", "line 16: follows the last"}})
    EXPECT_THAT(error_text<InputError>([&] { read(body); }), HasSubstr(line)) << body;
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
  write_file(folder / "a.obj", std::string("solid a\nfacet normal 0 0 1\n"));
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "a.obj"); }), HasSubstr("a.obj: content"));
  std::filesystem::remove(folder / "a.obj");
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
              HasSubstr("not an axis"));
}

/// A PLY of one triangle, with the given counts.
std::string ply_of(const std::string& vertices, const std::string& faces, const std::string& body) {
  return "ply\nformat ascii 1.0\nelement vertex " + vertices +
         "\nproperty float x\nproperty float y\nproperty float z\nelement face " + faces +
         "\nproperty list uchar int vertex_indices\nend_header\n" + body;
}

TEST(HostileMeshes, PlyFilesThatClaimMoreThanTheyHoldAreRefused) {
  const test::TemporaryFolder folder;
  const auto refusal = [&](const std::string& bytes) {
    write_file(folder / "a.ply", bytes);
    return error_text<InputError>([&] { read_mesh(folder / "a.ply"); });
  };
  const std::string corners = "0 0 0\n1 0 0\n0 1 0\n";
  write_file(folder / "good.ply", ply_of("3", "1", corners + "3 0 1 2\n"));
  EXPECT_EQ(read_mesh(folder / "good.ply").faces.size(), 1u);
  // The first one crashed another reader; the others took gigabytes, or minutes.
  EXPECT_THAT(refusal(ply_of("3", "1", "0 0 0\n")), HasSubstr("cannot hold"));
  EXPECT_THAT(refusal(ply_of("100000000", "100000000", corners)),
              HasSubstr("claims 100000000 of \"vertex\""));
  EXPECT_THAT(refusal(ply_of("4000000000", "1", corners)), HasSubstr("cannot hold"));
  EXPECT_THAT(refusal(ply_of("99999999999999999999999", "1", corners)), HasSubstr("NAME COUNT"));
  EXPECT_THAT(refusal(ply_of("-1", "1", corners)), HasSubstr("NAME COUNT"));
  EXPECT_THAT(refusal(ply_of("3", "18446744073709551615", corners)), HasSubstr("cannot hold"));
  std::string elements = "ply\nformat ascii 1.0\n";
  for (int i = 0; i < 2000; ++i) elements += fmt::format("element e{} 0\n", i);
  EXPECT_THAT(refusal(elements + "end_header\n"), HasSubstr("more than 32 elements"));
  EXPECT_THAT(refusal("ply\nformat ascii 1.0\n" + std::string(100'000, ' ') + "end_header\n"),
              HasSubstr("no end within"));
  EXPECT_THAT(refusal("ply\nelement vertex 0\nend_header\n"), HasSubstr("names no known format"));
  EXPECT_THAT(refusal("ply\nformat ascii 1.0\nelement vertex 3\nproperty colour x\nend_header\n"),
              HasSubstr("property line"));
  // Faces without corners, with vertex indices out of range, and lists that end too early.
  for (const char* faces : {"0 0 0 0\n", "3 0 1 7\n", "3 0 1 -2\n", "3 0 1\n", "200 0 1\n", "3 0 1 x\n"})
    EXPECT_THAT(refusal(ply_of("3", "1", corners + faces)), HasSubstr("a.ply")) << faces;
}

TEST(HostileMeshes, PolygonsOfAnyNumberOfCornersAreRefusedBeforeTheyAreCut) {
  const test::TemporaryFolder folder;
  std::string obj, few;
  for (int i = 0; i < 2000; ++i) obj += fmt::format("v {} {} 0\n", std::cos(i * 1e-3), std::sin(i * 1e-3));
  few = obj;
  obj += "f", few += "f";
  for (int i = 1; i <= 2000; ++i) obj += fmt::format(" {}", i);
  for (int i = 1; i <= 40; ++i) few += fmt::format(" {}", 50 * i);
  write_file(folder / "many.obj", obj + "\n");
  write_file(folder / "few.obj", few + "\n");
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "many.obj"); }),
              HasSubstr("face 0: has 2000 corners, not 1 to 1000; cut its polygons into triangles"));
  EXPECT_EQ(read_mesh(folder / "few.obj").faces.size(), 38u);
}

TEST(HostileMeshes, PolygonsThatTakeMinutesToCutAreRefusedTogether) {
  Polygons many("many.obj");
  for (int i = 0; i < 1000; ++i) many.add_vertex({std::cos(i * 6e-3), std::sin(i * 6e-3), 0});
  std::vector<int> all(1000);
  std::iota(all.begin(), all.end(), 0);
  for (int f = 0; f < 2; ++f) many.add_face(all);
  EXPECT_EQ(triangulated(many).faces.size(), 2u * 998);
  EXPECT_THAT(error_text<InputError>([&] {
                for (int f = 0; f < 200; ++f) many.add_face(all);
              }),
              HasSubstr("many.obj: faces: are too many of too many corners"));
}

TEST(MeshFiles, VerticesAtOnePlaceAreJoinedAndWhatNoFaceHasIsLeftOut) {
  const Mesh split = {
      {{5, 5, 5}, {0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {-0.0, 0, 0}},
      {{1, 2, 3}, {4, 5, 6}, {1, 7, 5}}};
  const Mesh one = welded(split);
  EXPECT_EQ(one.vertices, (std::vector<Vec3d>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}}));
  EXPECT_EQ(one.faces, (std::vector<Face>{{0, 1, 2}, {1, 3, 2}}));
}

}  // namespace

// OBJ out and in.

namespace {

using testing::ElementsAre;

TexturedMesh painted(int resolution) {
  TexturedMesh textured;
  textured.mesh = icosphere(1);
  textured.atlas.resolution = resolution;
  RandomStream random(11, "obj");
  for (std::size_t i = 0; i < textured.mesh.faces.size() * textured.atlas.per_face(); ++i)
    textured.atlas.texels.push_back({random.uniform(), random.uniform(), random.uniform()});
  return textured;
}

/// The colour as 8-bit sRGB keeps it.
Vec3d through_bytes(const Vec3d& colour) {
  ImageF one(1, 1, 3);
  for (int c = 0; c < 3; ++c) one.data[as_size(c)] = static_cast<float>(colour[c]);
  const auto bytes = srgb_bytes(one);
  return {linear_level(bytes[0]), linear_level(bytes[1]), linear_level(bytes[2])};
}

/// Each face's corners and the colour at the centre of its UVs, read strictly by the format.
struct Shown {
  std::vector<std::array<Vec3d, 3>> corners;
  std::vector<Vec3d> colours;
};

Shown shown_by(const std::filesystem::path& file) {
  const ImageF picture = read_srgb(std::filesystem::path(file).replace_extension(".png"));
  std::istringstream lines(read_file(file));
  std::vector<Vec3d> vertices;
  std::vector<Vec2d> uvs;
  Shown shown;
  for (std::string kind; lines >> kind;) {
    if (kind == "v") {
      Vec3d& v = vertices.emplace_back();
      lines >> v.x() >> v.y() >> v.z();
    } else if (kind == "vt") {
      Vec2d& uv = uvs.emplace_back();
      lines >> uv.x() >> uv.y();
    } else if (kind == "f") {
      Vec2d middle = Vec2d::Zero();
      auto& corners = shown.corners.emplace_back();
      for (Vec3d& corner : corners) {
        std::size_t vertex = 0, uv = 0;
        char slash = 0;
        lines >> vertex >> slash >> uv;
        corner = vertices.at(vertex - 1);
        middle += uvs.at(uv - 1) / 3;
      }
      const float* p = picture.pixel(static_cast<int>(middle.x() * picture.width),
                                     static_cast<int>((1 - middle.y()) * picture.height));
      shown.colours.emplace_back(p[0], p[1], p[2]);
    } else {
      std::getline(lines, kind);
    }
  }
  return shown;
}

TEST(ObjFile, IsReadBackWithTheSameVerticesAndTexels) {
  const test::TemporaryFolder folder;
  for (const int resolution : {1, 3, 5}) {
    const TexturedMesh given = standing_on_origin(painted(resolution));
    write_obj(folder / "adversary.obj", given);
    const Shown back = shown_by(folder / "adversary.obj");
    const Mesh mesh = read_mesh(folder / "adversary.obj");
    const auto triangles = atlas_triangles(resolution);
    ASSERT_EQ(back.corners.size(), given.mesh.faces.size() * triangles.size());
    ASSERT_EQ(mesh.faces.size(), back.corners.size());
    std::size_t at = 0;
    for (std::size_t f = 0; f < given.mesh.faces.size(); ++f)
      for (const AtlasTriangle& triangle : triangles) {
        for (int k = 0; k < 3; ++k) {
          const Vec2d& b = triangle.corners[as_size(k)];
          const Face& face = given.mesh.faces[f];
          const Vec3d expected = b.x() * given.mesh.vertices[as_size(face[0])] +
                                 b.y() * given.mesh.vertices[as_size(face[1])] +
                                 (1 - b.x() - b.y()) * given.mesh.vertices[as_size(face[2])];
          ASSERT_LT((back.corners[at][as_size(k)] - expected).norm(), 1e-6);
          const int read = mesh.faces[at][as_size(k)];
          ASSERT_LT((mesh.vertices[as_size(read)] - expected).norm(), 1e-6);
        }
        const Vec3d texel =
            through_bytes(given.atlas.texels[f * given.atlas.per_face() + as_size(triangle.texel)]);
        ASSERT_LT((back.colours[at] - texel).norm(), 1e-7) << "face " << f << ", texel " << triangle.texel;
        ++at;
      }
    EXPECT_NEAR(bounds(mesh).min().z(), 0, 1e-7);
    EXPECT_NEAR(signed_volume(mesh), signed_volume(given.mesh), 1e-6);
  }
}

TEST(ObjFile, WithoutTexelsItIsGreyAndItsVerticesAreShared) {
  const test::TemporaryFolder folder;
  TexturedMesh plain;
  plain.mesh = icosphere(1);
  plain.atlas.texels.clear();
  write_obj(folder / "plain.obj", plain);
  EXPECT_FALSE(std::filesystem::exists(folder / "plain.png"));
  const Mesh back = read_mesh(folder / "plain.obj");
  EXPECT_EQ(back.vertices.size(), plain.mesh.vertices.size());
  EXPECT_TRUE(is_watertight(back));
  EXPECT_THAT(read_file(folder / "plain.mtl"), HasSubstr("Kd 0.5 0.5 0.5"));
  EXPECT_THAT(error_text<InputError>([&] { write_obj(folder / "plain.stl", plain); }), HasSubstr(".obj"));
}

Polygons polygons_of(const std::string& text) {
  const test::TemporaryFolder folder;
  write_file(folder / "a.obj", text);
  return read_polygons(folder / "a.obj", "a.obj", read_obj);
}

TEST(ReadObj, ReadsWhatOthersWrite) {
  const Polygons read = polygons_of(
      "# a comment\nmtllib any.mtl\no thing\n  v +1 2.5 -3e-1 1.0 0.5 0.5 0.5\r\nv 0 0 0\t\nv 1 0 0\nvt 0 "
      "1\nvn 0 "
      "0 1\nv 0 1 0\nusemtl paint\ns off\nl 1 2\nf 2/1/1 3//1 4/1\nf -3 -2 \\\n -1 -4 # the rest\nf 1 2 5\nv "
      "9 9 "
      "9");
  ASSERT_EQ(read.vertex_count(), 5u);
  EXPECT_EQ(read.vertices()[0], Vec3d(1, 2.5, -0.3));
  ASSERT_EQ(read.face_count(), 3u);
  EXPECT_THAT(read.face(0), ElementsAre(1, 2, 3));
  EXPECT_THAT(read.face(1), ElementsAre(1, 2, 3, 0));
  EXPECT_THAT(read.face(2), ElementsAre(0, 1, 4));
  EXPECT_EQ(polygons_of("").face_count(), 0u);
}

TEST(ReadObj, RefusesWhatItCannotTakeAsMeant) {
  const auto refusal = [](const std::string& text) {
    return error_text<InputError>([&] { polygons_of("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + text); });
  };
  for (const char* vertex : {"v 1 2", "v", "v 1 2 x", "v 1 2 1e999", "v 1 2 nan", "v inf 1 2", "v 1 2 3x"})
    EXPECT_THAT(refusal(vertex), HasSubstr("a.obj: line 4: is a vertex without three finite numbers"))
        << vertex;
  for (const char* face : {"f 1 2 0", "f 1 2 x", "f 1 2 /3", "f 1 2 3.5", "f 1 2 99999999999"})
    EXPECT_THAT(refusal(face), HasSubstr("line 4: is a face with a corner that is not a vertex's number"))
        << face;
  EXPECT_THAT(refusal("f 1 2 4"), HasSubstr("face 0: names vertex 3 of 3"));
  EXPECT_THAT(refusal("f 1 2 -4"), HasSubstr("face 0: names vertex -1, which is not a vertex's number"));
  EXPECT_THAT(refusal("f 1 2 -2147483648"), HasSubstr("face 0: names vertex"));
  EXPECT_THAT(refusal("f"), HasSubstr("face 0: has 0 corners, not 1 to 1000"));
  EXPECT_THAT(refusal("f 1 2 4\nv 1 1 1\nf 1 2 6 5 4 3"), HasSubstr("face 1: names vertex 5 of 4"));
  EXPECT_THAT(refusal("v 1 1 1e8"), HasSubstr("vertex 3: is not within 1e+07 m"));
  EXPECT_THAT(refusal("f 1 2 \\\n 3 \\\r\n\n# \\\n f 1 2 9\nf 1 2 x"), HasSubstr("line 9: is a face with"));
  EXPECT_THAT(refusal(fmt::format("f 1 2 3{:2000000}\nv 1", "")), HasSubstr("line 4: is too long"));
  EXPECT_EQ(polygons_of(fmt::format("#{:2000000}\nv 1 2 3", "")).vertex_count(), 1u);
}

}  // namespace
}  // namespace mirage
