#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/buildable.h"
#include "base/error.h"
#include "base/random.h"
#include "geometry/self_intersection.h"
#include "support/files.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

TexturedMesh start(const BuildableSettings& settings) {
  TexturedMesh adversary = initial_adversary();
  make_buildable(adversary, settings, {});
  return adversary;
}

double thinnest(const Mesh& mesh) {
  double least = 1e9;
  for (const Wall& wall : walls(mesh)) least = std::min(least, wall.thickness);
  return least;
}

/// A step as a wild optimiser makes it.
void shake(TexturedMesh& adversary, RandomStream& random, double amount) {
  for (Vec3d& v : adversary.mesh.vertices)
    for (int c = 0; c < 3; ++c) v[c] += amount * random.normal();
  for (Vec3d& t : adversary.atlas.texels)
    for (int c = 0; c < 3; ++c) t[c] += random.normal();
  project(adversary, {});
}

TEST(Buildable, TheStartStandsFlat) {
  BuildableSettings settings;
  settings.on = true;
  const TexturedMesh adversary = start(settings);
  const auto report = buildable_report(adversary, settings);
  EXPECT_EQ(report.intersecting_pairs, 0u);
  EXPECT_GE(report.base_vertices, 10);
  EXPECT_GT(report.base_area, 0.2);
  EXPECT_GT(report.min_thickness, 0.05);
  EXPECT_EQ(report.printable, 1.0);
  EXPECT_TRUE(report.watertight);
  EXPECT_EQ(to_json(report), (nlohmann::json{{"intersecting_pairs", 0},
                                             {"min_thickness_m", report.min_thickness},
                                             {"base_vertices", report.base_vertices},
                                             {"base_area_m2", report.base_area},
                                             {"watertight", true},
                                             {"texels_in_print_range", 1.0}}));
  // The plain start stands on a point.
  EXPECT_EQ(buildable_report(initial_adversary(), settings).base_area, 0.0);
}

TEST(Buildable, StaysSoUnderWildSteps) {
  BuildableSettings settings;
  settings.on = true;
  settings.min_thickness = 0.02;
  for (const double amount : {0.005, 0.05, 0.5}) {
    RandomStream random(7, "wild steps");
    TexturedMesh adversary = start(settings);
    const TexturedMesh first = adversary;
    TexturedMesh loose = adversary;
    double moved = 0;
    for (int i = 0; i < 25; ++i) {
      const TexturedMesh before = adversary;
      shake(adversary, random, amount);
      keep_buildable(adversary, before, settings, {});
      ASSERT_TRUE(intersecting_faces(adversary.mesh).empty()) << amount << ", step " << i;
      ASSERT_GE(thinnest(adversary.mesh), settings.min_thickness) << amount << ", step " << i;
    }
    for (std::size_t i = 0; i < first.mesh.vertices.size(); ++i)
      moved += (adversary.mesh.vertices[i] - first.mesh.vertices[i]).norm();
    // The rules must not freeze the mesh; half a metre at random leaves nothing to keep.
    const double mean = moved / static_cast<double>(first.mesh.vertices.size());
    EXPECT_GT(mean, amount < 0.5 ? amount / 50 : 0);
    const auto report = buildable_report(adversary, settings);
    EXPECT_EQ(report.base_vertices, buildable_report(first, settings).base_vertices);
    EXPECT_EQ(report.printable, 1.0);
    // Without the rules the same steps make something that is no solid.
    RandomStream again(7, "wild steps");
    for (int i = 0; i < 25; ++i) shake(loose, again, amount);
    if (amount >= 0.05) {
      EXPECT_FALSE(intersecting_faces(loose.mesh).empty());
    }
  }
}

TEST(Buildable, AStepThatBreaksNoRuleIsKeptAsItIs) {
  BuildableSettings settings;
  settings.on = true;
  const TexturedMesh before = start(settings);
  TexturedMesh after = before;
  for (Vec3d& v : after.mesh.vertices)
    if (v.z() > 0) v.z() += 0.01;
  const auto wanted = after.mesh.vertices;
  keep_buildable(after, before, settings, {});
  EXPECT_EQ(after.mesh.vertices, wanted);
}

TEST(Buildable, AThicknessThatNoMeshHasIsRefused) {
  BuildableSettings settings;
  settings.min_thickness = 3;
  EXPECT_THAT(test::error_text<InputError>([&] { check_buildable(settings, {}); }),
              HasSubstr("min_thickness: 3"));
  settings.min_thickness = -1;
  EXPECT_THAT(test::error_text<InputError>([&] { check_buildable(settings, {}); }), HasSubstr("use 0 to"));
}

}  // namespace
}  // namespace mirage
