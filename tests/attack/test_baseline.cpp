// The controls that a learned mesh is compared with.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <set>
#include <tuple>

#include "attack/adversary.h"
#include "attack/baseline.h"
#include "attack/buildable.h"
#include "base/error.h"
#include "base/random.h"
#include "geometry/solid.h"
#include "support/files.h"

namespace mirage {
namespace {

/// A run with a learned mesh of uneven extents off the centre.
Run run_with_mesh(bool buildable = false) {
  Run run;
  run.settings.seed = 4;
  run.settings.buildable.on = buildable;
  run.adversary = initial_adversary(run.settings.limits);
  if (buildable) make_buildable(run.adversary, run.settings.buildable, run.settings.limits);
  for (Vec3d& v : run.adversary.mesh.vertices) {
    v.x() = 0.9 * v.x() + 0.1;
    v.y() *= 1.3;
    if (!buildable || v.z() > 0) v.z() *= 0.8;
  }
  project(run.adversary, run.settings.limits);
  run.random = random_adversary(run.settings.seed, run.settings.limits);
  return run;
}

TEST(Baseline, WordsAreReadAndOthersRefused) {
  EXPECT_THAT(parse_baselines("sized,cuboid,sized"), testing::ElementsAre(Baseline::sized, Baseline::cuboid));
  EXPECT_EQ(parse_baselines("all").size(), 4u);
  EXPECT_TRUE(parse_baselines("none").empty());
  EXPECT_TRUE(parse_baselines("").empty());
  for (const char* bad : {"none,start", "sized,all"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_baselines(bad); }),
                testing::AllOf(testing::StartsWith("baseline: "), testing::HasSubstr("and others")));
  for (const Baseline kind : parse_baselines("all"))
    EXPECT_THAT(parse_baselines(to_word(kind)), testing::ElementsAre(kind));
  EXPECT_THAT(test::error_text<InputError>([] { parse_baselines("start,sphere"); }),
              testing::StartsWith("baseline: sphere: unknown; use start, sized"));
}

TEST(Baseline, ASizedMeshHasExactlyTheLearnedOnesExtentsAndCentre) {
  for (const bool buildable : {false, true}) {
    const mirage::Run run = run_with_mesh(buildable);
    const Eigen::AlignedBox3d wanted = bounds(run.adversary.mesh);
    const auto meshes = baseline_meshes(run, Baseline::sized, 3);
    for (const TexturedMesh& mesh : meshes) {
      const Eigen::AlignedBox3d made = bounds(mesh.mesh);
      if (buildable) {  // the rules may move a vertex back towards the start, which fixes the extents
        EXPECT_NEAR((made.min() - wanted.min()).norm() + (made.max() - wanted.max()).norm(), 0, 0.05);
        EXPECT_TRUE(intersecting_faces(mesh.mesh).empty());
        EXPECT_EQ(buildable_report(mesh, run.settings.buildable).printable, 1.0);
      } else {
        EXPECT_EQ(made.min(), wanted.min());
        EXPECT_EQ(made.max(), wanted.max());
      }
      EXPECT_NE(mesh.mesh.vertices, run.adversary.mesh.vertices);
    }
    EXPECT_NE(meshes[0].mesh.vertices, meshes[1].mesh.vertices);
    EXPECT_NE(meshes[0].atlas.texels, meshes[1].atlas.texels);
    EXPECT_EQ(baseline_meshes(run, Baseline::sized, 2)[1].mesh.vertices, meshes[1].mesh.vertices);
  }
}

TEST(Baseline, EllipsoidAndCuboidFillTheBox) {
  for (const bool buildable : {false, true}) {
    const mirage::Run run = run_with_mesh(buildable);
    const Vec3d half = run.settings.limits.half;
    for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid}) {
      const TexturedMesh made = baseline_meshes(run, kind, 1).at(0);
      EXPECT_NEAR((bounds(made.mesh).max() - half).norm(), 0, 1e-12);
      EXPECT_NEAR((bounds(made.mesh).min() + half).norm(), 0, 1e-12);
      EXPECT_TRUE(is_watertight(made.mesh));
      EXPECT_TRUE(intersecting_faces(made.mesh).empty());
      check_mesh(made, to_word(kind));
    }
    const double volume = signed_volume(baseline_meshes(run, Baseline::cuboid, 1).at(0).mesh);
    EXPECT_NEAR(volume, 8 * half.prod(), 1e-12);  // wound outwards, too
  }
}

TEST(Baseline, TheStartIsTheRandomMeshOfTheRun) {
  const mirage::Run run = run_with_mesh();
  const auto meshes = baseline_meshes(run, Baseline::start, 2);
  EXPECT_EQ(meshes[0].mesh.vertices, run.random.mesh.vertices);
  EXPECT_EQ(meshes[1].mesh.vertices,
            random_baseline(5, run.settings.limits, run.settings.buildable).mesh.vertices);
}

TEST(Baseline, PatchesAreLargeAndConnected) {
  TexturedMesh mesh = initial_adversary();
  paint_patches(mesh, 12, 7);
  const auto key = [](const Vec3d& t) { return std::tuple(t.x(), t.y(), t.z()); };
  std::map<std::tuple<double, double, double>, std::vector<std::size_t>> patches;
  const std::size_t per_face = mesh.atlas.per_face();
  for (std::size_t f = 0; f < mesh.mesh.faces.size(); ++f) {
    for (std::size_t t = 1; t < per_face; ++t)
      EXPECT_EQ(mesh.atlas.texels[f * per_face + t], mesh.atlas.texels[f * per_face]);
    patches[key(mesh.atlas.texels[f * per_face])].push_back(f);
  }
  EXPECT_EQ(patches.size(), 12u);
  for (const auto& [colour, faces] : patches) {  // each patch grows over shared edges from any of its faces
    std::set<std::size_t> left(faces.begin(), faces.end());
    std::vector<std::size_t> front = {*left.begin()};
    left.erase(left.begin());
    while (!front.empty()) {
      const Face at = mesh.mesh.faces[front.back()];
      front.pop_back();
      for (auto other = left.begin(); other != left.end();) {
        int shared = 0;
        for (const int a : {at[0], at[1], at[2]})
          for (const int b :
               {mesh.mesh.faces[*other][0], mesh.mesh.faces[*other][1], mesh.mesh.faces[*other][2]})
            shared += a == b;
        if (shared < 2) {
          ++other;
          continue;
        }
        front.push_back(*other);
        other = left.erase(other);
      }
    }
    EXPECT_TRUE(left.empty());
  }
  TexturedMesh same = initial_adversary();
  paint_patches(same, 12, 7);
  EXPECT_EQ(same.atlas.texels, mesh.atlas.texels);
  paint_patches(same, 100000, 7);  // at most one patch per face
  TexturedMesh none;
  paint_patches(none, 3, 7);
  EXPECT_TRUE(none.atlas.texels.empty());
}

TEST(Baseline, BoundsOfDegenerateMeshesAreMoved) {
  Mesh flat;
  flat.vertices = {{0, 0, 2}, {1, 0, 2}, {0, 3, 2}};
  flat.faces = {{0, 1, 2}};
  fit_bounds(flat, Eigen::AlignedBox3d(Vec3d(-1, -1, 5), Vec3d(1, 1, 6)));
  EXPECT_EQ(flat.vertices[1], Vec3d(1, -1, 5));
  EXPECT_EQ(flat.vertices[2], Vec3d(-1, 1, 5));
}

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

/// A large random step, as a badly tuned optimiser would take.
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
  EXPECT_EQ(fields_json(report), (nlohmann::json{{"intersecting_pairs", 0},
                                                 {"min_thickness_m", report.min_thickness},
                                                 {"base_vertices", report.base_vertices},
                                                 {"base_area_m2", report.base_area},
                                                 {"watertight", true},
                                                 {"texels_in_print_range", 1.0}}));
  // The plain start stands on a point.
  EXPECT_EQ(buildable_report(initial_adversary(), settings).base_area, 0.0);
}

TEST(Buildable, AStepIsAMapOfSpaceThatFoldsNothing) {
  const BuildableSettings settings;
  TexturedMesh solid = start(settings), loose = solid;
  const std::vector<Vec3d> first = solid.mesh.vertices;
  RandomStream random(11, "gradient");
  std::vector<Vec3d> gradient(first.size());
  for (Vec3d& g : gradient) g = {random.normal(), random.normal(), random.normal()};
  Adam adam, other;
  adam.learning_rate = other.learning_rate = 0.02;
  for (int i = 0; i < 8; ++i) {
    step_buildable(adam, solid.mesh.vertices, gradient, {});
    other.step(loose.mesh.vertices, gradient);
  }
  EXPECT_EQ(adam.learning_rate, 0.02);
  double moved = 0;
  for (std::size_t i = 0; i < first.size(); ++i) {
    moved += (solid.mesh.vertices[i] - first[i]).norm() / static_cast<double>(first.size());
    EXPECT_LE((solid.mesh.vertices[i].cwiseAbs() - AdversaryLimits().half).maxCoeff(), 1e-12);
  }
  EXPECT_GT(moved, 0.05);
  EXPECT_TRUE(intersecting_faces(solid.mesh).empty());
  EXPECT_FALSE(intersecting_faces(loose.mesh).empty());
}

TEST(Buildable, ThinWallsAreMovedApart) {
  BuildableSettings settings;
  const TexturedMesh before = start(settings);
  TexturedMesh after = before;
  const double top = bounds(before.mesh).max().z();
  for (Vec3d& v : after.mesh.vertices)
    if (v.z() > -0.5) v.z() = -0.5 + 0.012 * (v.z() + 0.5) / (top + 0.5);
  EXPECT_LT(thinnest(after.mesh), 0.01);
  keep_buildable(after, before, settings, {});
  EXPECT_GE(thinnest(after.mesh), 0.01);
}

TEST(Buildable, AStartThatStandsIsNotCut) {
  const BuildableSettings settings;
  TexturedMesh once = start(settings);
  EXPECT_EQ(bounds(once.mesh).min().z(), -AdversaryLimits().half.z());
  const auto vertices = once.mesh.vertices;
  make_buildable(once, settings, {});
  EXPECT_EQ(once.mesh.vertices, vertices);
  for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid}) {
    const TexturedMesh shape = filling_shape(kind, {}, settings);
    EXPECT_TRUE(bounds(shape.mesh).isApprox(Eigen::AlignedBox3d(-kRoofBox, kRoofBox), 1e-12))
        << to_word(kind);
    EXPECT_TRUE(buildable_report(shape, settings).holds(settings.min_thickness)) << to_word(kind);
  }
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
    // The rules must not freeze the mesh; random steps of half a metre would leave nothing to preserve.
    const double mean = moved / static_cast<double>(first.mesh.vertices.size());
    EXPECT_GT(mean, amount < 0.5 ? amount / 50 : 0);
    const auto report = buildable_report(adversary, settings);
    EXPECT_EQ(report.base_vertices, buildable_report(first, settings).base_vertices);
    EXPECT_EQ(report.printable, 1.0);
    // Without the rules, the same steps give a mesh that is no solid.
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
