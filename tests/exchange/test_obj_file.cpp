// OBJ out and in.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/random.h"
#include "base/srgb_bytes.h"
#include "exchange/mesh_files.h"
#include "exchange/obj_file.h"
#include "exchange/polygons.h"
#include "geometry/atlas_triangles.h"
#include "geometry/shapes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::ElementsAre;
using testing::HasSubstr;

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
  for (int c = 0; c < 3; ++c) one.data[static_cast<std::size_t>(c)] = static_cast<float>(colour[c]);
  const auto bytes = srgb_bytes(one);
  return {linear_level(bytes[0]), linear_level(bytes[1]), linear_level(bytes[2])};
}

/// Each face's corners and the colour at the middle of its UVs, read by the letter of the format.
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
          const Vec2d& b = triangle.corners[static_cast<std::size_t>(k)];
          const Face& face = given.mesh.faces[f];
          const Vec3d expected = b.x() * given.mesh.vertices[static_cast<std::size_t>(face[0])] +
                                 b.y() * given.mesh.vertices[static_cast<std::size_t>(face[1])] +
                                 (1 - b.x() - b.y()) * given.mesh.vertices[static_cast<std::size_t>(face[2])];
          ASSERT_LT((back.corners[at][static_cast<std::size_t>(k)] - expected).norm(), 1e-6);
          const int read = mesh.faces[at][static_cast<std::size_t>(k)];
          ASSERT_LT((mesh.vertices[static_cast<std::size_t>(read)] - expected).norm(), 1e-6);
        }
        const Vec3d texel = through_bytes(
            given.atlas.texels[f * given.atlas.per_face() + static_cast<std::size_t>(triangle.texel)]);
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
    EXPECT_THAT(refusal(face), HasSubstr("line 4: is a face with a corner that is no vertex's number"))
        << face;
  EXPECT_THAT(refusal("f 1 2 4"), HasSubstr("face 0: names vertex 3 of 3"));
  EXPECT_THAT(refusal("f 1 2 -4"), HasSubstr("face 0: names vertex -1, which is none's number"));
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
