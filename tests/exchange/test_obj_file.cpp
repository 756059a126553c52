// OBJ out, and back through assimp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "base/srgb_bytes.h"
#include "exchange/mesh_files.h"
#include "exchange/obj_file.h"
#include "geometry/atlas_triangles.h"
#include "geometry/shapes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
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

TEST(ObjFile, IsReadBackWithTheSameVerticesAndTexels) {
  const test::TemporaryFolder folder;
  for (const int resolution : {1, 3, 5}) {
    const TexturedMesh given = standing_on_origin(painted(resolution));
    write_obj(folder / "adversary.obj", given);
    const TexturedMesh back = read_textured_mesh(folder / "adversary.obj");
    const auto triangles = atlas_triangles(resolution);
    ASSERT_EQ(back.mesh.faces.size(), given.mesh.faces.size() * triangles.size());
    ASSERT_EQ(back.atlas.texels.size(), back.mesh.faces.size());
    std::size_t at = 0;
    for (std::size_t f = 0; f < given.mesh.faces.size(); ++f)
      for (const AtlasTriangle& triangle : triangles) {
        for (int k = 0; k < 3; ++k) {
          const Vec2d& b = triangle.corners[static_cast<std::size_t>(k)];
          const Face& face = given.mesh.faces[f];
          const Vec3d expected = b.x() * given.mesh.vertices[static_cast<std::size_t>(face[0])] +
                                 b.y() * given.mesh.vertices[static_cast<std::size_t>(face[1])] +
                                 (1 - b.x() - b.y()) * given.mesh.vertices[static_cast<std::size_t>(face[2])];
          const Vec3d& is =
              back.mesh.vertices[static_cast<std::size_t>(back.mesh.faces[at][static_cast<std::size_t>(k)])];
          ASSERT_LT((is - expected).norm(), 1e-6);
        }
        const Vec3d texel = through_bytes(
            given.atlas.texels[f * given.atlas.per_face() + static_cast<std::size_t>(triangle.texel)]);
        ASSERT_LT((back.atlas.texels[at] - texel).norm(), 1e-7)
            << "face " << f << ", texel " << triangle.texel;
        ++at;
      }
    EXPECT_NEAR(bounds(back.mesh).min().z(), 0, 1e-7);
    EXPECT_NEAR(signed_volume(back.mesh), signed_volume(given.mesh), 1e-6);
  }
}

TEST(ObjFile, WithoutTexelsItIsGreyAndItsVerticesAreShared) {
  const test::TemporaryFolder folder;
  TexturedMesh plain;
  plain.mesh = icosphere(1);
  plain.atlas.texels.clear();
  write_obj(folder / "plain.obj", plain);
  EXPECT_FALSE(std::filesystem::exists(folder / "plain.png"));
  const TexturedMesh back = read_textured_mesh(folder / "plain.obj");
  EXPECT_EQ(back.mesh.vertices.size(), plain.mesh.vertices.size());
  EXPECT_TRUE(is_watertight(back.mesh));
  EXPECT_NEAR(back.atlas.texels[0].x(), 0.5, 1e-6);
  EXPECT_THAT(error_text<InputError>([&] { write_obj(folder / "plain.stl", plain); }), HasSubstr(".obj"));
}

}  // namespace
}  // namespace mirage
