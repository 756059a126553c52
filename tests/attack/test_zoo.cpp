// The zoo's parts: closed loads, texels at another resolution per face, files that describe themselves.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/adversary.h"
#include "attack/zoo.h"
#include "base/error.h"
#include "base/files.h"
#include "exchange/gltf.h"
#include "support/files.h"

namespace mirage {
namespace {

TEST(Zoo, LoadsAreClosedAndStandOnTheRoof) {
  ASSERT_EQ(carried_loads().size(), 5u);
  for (const CarriedLoad& known : carried_loads()) {
    const TexturedMesh load = carried_load(known.name);
    EXPECT_TRUE(is_watertight(load.mesh)) << known.name;
    EXPECT_GT(signed_volume(load.mesh), 0) << known.name;
    EXPECT_EQ(load.atlas.texels.size(), load.mesh.faces.size()) << known.name;
    const Eigen::AlignedBox3d box = bounds(load.mesh);
    EXPECT_NEAR(box.min().z(), 0, 0.02) << known.name;
    EXPECT_GT(box.sizes().z(), 0.07) << known.name;
    EXPECT_LT(box.sizes().x(), 3) << known.name;
    EXPECT_LT(box.sizes().y(), 1.5) << known.name;
    EXPECT_NEAR(box.center().y(), 0, 0.03) << known.name;
  }
  EXPECT_THROW(carried_load("piano"), InputError);
}

TEST(Zoo, ResampledTexelsAreMeansOfWhatTheyCover) {
  TexturedMesh two{{}, {5, {}}};
  two.mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
  two.mesh.faces = {{0, 1, 2}, {1, 3, 2}};
  for (int i = 0; i < 2 * 25; ++i) two.atlas.texels.push_back(Vec3d(i / 50.0, 0.5, 1));
  const TexelAtlas same = resampled(two, 5).atlas, one = resampled(two, 1).atlas;
  for (std::size_t i = 0; i < same.texels.size(); ++i)
    EXPECT_NEAR((same.texels[i] - two.atlas.texels[i]).norm(), 0, 1e-12);
  ASSERT_EQ(one.texels.size(), 2u);
  EXPECT_NEAR(one.texels[0].y(), 0.5, 1e-12);
  EXPECT_NEAR(one.texels[1].x() - one.texels[0].x(), 0.5, 1e-12);
  EXPECT_NEAR(one.texels[0].x(), 12 / 50.0, 0.02);  // the mean of the first face
}

TEST(Zoo, FilesSayWhatTheyAreAndComeBackBitForBit) {
  test::TemporaryFolder folder;
  const TexturedMesh mesh = random_adversary(3);
  write_adversary(folder / "a.glb", mesh, {{"name", "a"}, {"licence", "Apache-2.0"}});
  EXPECT_THAT(read_file(folder / "a.glb"), testing::HasSubstr("\"copyright\":\"Apache-2.0\""));
  const auto objects = read_objects({folder / "a.glb"});
  EXPECT_EQ(objects.at(0).mesh.mesh.vertices, mesh.mesh.vertices);
  EXPECT_EQ(objects.at(0).mesh.atlas.texels, mesh.atlas.texels);
  EXPECT_THAT(test::error_text<FieldError>([&] {
                read_objects({folder / "a.glb", folder / "a.glb"});
              }),
              testing::HasSubstr("named twice"));
}

TEST(Zoo, WhatShipsIsSmallAndSaysWhereItComesFrom) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const auto folder = std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "objects";
  const auto objects = read_objects({kZoo});
  const nlohmann::json table = read_json(folder / "zoo.json");
  EXPECT_EQ(table.at("objects").size(), objects.size());
  for (const nlohmann::json& about : table.at("objects")) {
    const auto file = folder / (about.at("name").get<std::string>() + ".glb");
    EXPECT_LE(std::filesystem::file_size(file), 300'000u) << file;
    EXPECT_EQ(about.at("licence"), "Apache-2.0");
    EXPECT_LE(about.at("vanished").at("low"), about.at("vanished").at("high"));
  }
}

}  // namespace
}  // namespace mirage
