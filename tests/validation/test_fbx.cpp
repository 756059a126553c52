// FBX out through Blender, and opened by Blender again. Skipped where Blender is not installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "base/srgb_bytes.h"
#include "exchange/obj_file.h"
#include "fixture.h"
#include "geometry/atlas_triangles.h"
#include "support/files.h"
#include "validation/blender/fbx_export.h"

namespace mirage {
namespace {

TEST(Fbx, IsOpenedWithTheSameVerticesTexelsAndPivot) {
  if (find_program("blender").empty()) GTEST_SKIP() << "blender is not installed";
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const test::TemporaryFolder folder;
  TexturedMesh given = test::random_mesh(4, 5);
  for (Vec3d& v : given.mesh.vertices) v += Vec3d(0.1, -0.05, 0.3);  // its middle is not its pivot
  const TexturedMesh standing = standing_on_origin(given);
  BlenderWorker blender(folder / "blender.log");
  write_fbx(blender, folder / "adversary.fbx", given);
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
    files += entry.path().extension() == ".fbx" || entry.path().extension() == ".glb";
  EXPECT_EQ(files, 1u);
  const auto seen = blender.request({{"job", "inspect"}, {"file", (folder / "adversary.fbx").string()}}, 60);
  EXPECT_EQ(seen.at("materials"), 1);
  EXPECT_EQ(seen.at("pictures"), 1);
  EXPECT_TRUE(seen.at("packed").get<bool>());
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(seen.at("origin").at(static_cast<std::size_t>(k)).get<double>(), 0, 1e-6);
    EXPECT_NEAR(seen.at("scale").at(static_cast<std::size_t>(k)).get<double>(), 1, 1e-5);
  }
  const auto triangles = atlas_triangles(given.atlas.resolution);
  const auto& corners = seen.at("triangles");
  const auto& texels = seen.at("texels");
  ASSERT_EQ(corners.size(), given.mesh.faces.size() * triangles.size());
  ASSERT_EQ(texels.size(), corners.size());
  double furthest = 0;
  int other = 0;
  std::size_t at = 0;
  for (std::size_t f = 0; f < given.mesh.faces.size(); ++f)
    for (const AtlasTriangle& triangle : triangles) {
      // A program may start a triangle at another corner.
      double best = 1e9;
      for (int turn = 0; turn < 3; ++turn) {
        double worst = 0;
        for (int k = 0; k < 3; ++k) {
          const Vec2d& b = triangle.corners[static_cast<std::size_t>(k)];
          const Face& face = standing.mesh.faces[f];
          const auto vertex = [&](int of) {
            return standing.mesh.vertices[static_cast<std::size_t>(face[static_cast<std::size_t>(of)])];
          };
          const Vec3d expected = b.x() * vertex(0) + b.y() * vertex(1) + (1 - b.x() - b.y()) * vertex(2);
          const auto& p = corners.at(at).at(static_cast<std::size_t>((k + turn) % 3));
          worst = std::max(worst, (Vec3d(p.at(0), p.at(1), p.at(2)) - expected).norm());
        }
        best = std::min(best, worst);
      }
      furthest = std::max(furthest, best);
      ImageF one(1, 1, 3);
      const Vec3d& texel =
          given.atlas.texels[f * given.atlas.per_face() + static_cast<std::size_t>(triangle.texel)];
      for (int c = 0; c < 3; ++c) one.data[static_cast<std::size_t>(c)] = static_cast<float>(texel[c]);
      const auto bytes = srgb_bytes(one);
      for (std::size_t c = 0; c < 3; ++c) other += texels.at(at).at(c) != bytes[c];
      ++at;
    }
  EXPECT_LT(furthest, 2e-6);
  EXPECT_EQ(other, 0);
}

}  // namespace
}  // namespace mirage
