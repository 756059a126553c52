// --attack black-box: an evolution strategy on scores alone, and its low-dimensional mesh parameters.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "attack/attack.h"
#include "attack/black_box.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/json_fields.h"
#include "exchange/gltf.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

TEST(Evolution, FindsALowestValueAndIsRestoredByItsValues) {
  const auto f = [](const std::vector<double>& x) {
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i) sum += std::pow(x[i] - 0.3 * static_cast<double>(i), 2);
    return sum;
  };
  Evolution search(6, 12, 4);
  const double start = f(search.centre());
  std::vector<double> values;
  for (int i = 0; i < 245; ++i) search.add((values.push_back(f(search.next())), values.back()));
  EXPECT_LT(f(search.centre()), 0.05 * start);
  Evolution again(6, 12, 4), other(6, 12, 5);
  for (const double value : values) again.add(value);
  EXPECT_EQ(again.centre(), search.centre());
  EXPECT_EQ(again.next(), search.next());
  EXPECT_NE(other.next(), Evolution(6, 12, 4).next());
}

TEST(MeshModes, KeepTheMeshInItsBoxAndItsOwnMirrorImage) {
  const AdversaryLimits limits;
  const TexturedMesh start = initial_adversary(limits);
  const MeshModes modes(start, limits, AttackParts::both, true);
  const TexturedMesh same = modes.mesh(std::vector<double>(modes.size(), 0.0));
  EXPECT_EQ(same.mesh.vertices, start.mesh.vertices);
  for (std::size_t i = 0; i < start.atlas.texels.size(); ++i)
    EXPECT_NEAR((same.atlas.texels[i] - start.atlas.texels[i]).norm(), 0, 1e-12);
  RandomStream random(3, "modes");
  std::vector<double> numbers(modes.size());
  for (double& x : numbers) x = 3 * random.normal();
  const TexturedMesh changed = modes.mesh(numbers);
  TexturedMesh inside = changed;
  project(inside, limits);
  EXPECT_EQ(inside.mesh.vertices, changed.mesh.vertices);
  EXPECT_EQ(inside.atlas.texels, changed.atlas.texels);
  EXPECT_NE(changed.atlas.texels, start.atlas.texels);
  int pairs = 0;
  const auto& before = start.mesh.vertices;
  for (std::size_t i = 0; i < before.size(); ++i)
    for (std::size_t j = 0; j < before.size(); ++j) {
      if ((before[i] - before[j].cwiseProduct(Vec3d(1, -1, 1))).norm() > 1e-9) continue;
      ++pairs;
      const Vec3d mirrored = changed.mesh.vertices[j].cwiseProduct(Vec3d(1, -1, 1));
      EXPECT_NEAR((changed.mesh.vertices[i] - mirrored).norm(), 0, 1e-9);
    }
  EXPECT_EQ(pairs, 162);
}

TEST(MeshModes, AreThoseOfThePartsThatAreLearned) {
  const AdversaryLimits limits;
  const TexturedMesh start = initial_adversary(limits);
  const auto of = [&](AttackParts parts, bool texture) { return MeshModes(start, limits, parts, texture); };
  EXPECT_EQ(of(AttackParts::size, true).size(), 3u);
  const std::size_t shape = of(AttackParts::shape, true).size(),
                    texture = of(AttackParts::texture, true).size();
  EXPECT_EQ(of(AttackParts::both, true).size(), shape + texture);
  EXPECT_EQ(of(AttackParts::both, false).size(), shape);  // no sensor sees colours
  const TexturedMesh larger = of(AttackParts::size, true).mesh(std::vector<double>{0.5, 0, -0.5});
  const Vec3d ratio = half_lengths(larger.mesh).cwiseQuotient(half_lengths(start.mesh));
  EXPECT_NEAR(ratio.x() * ratio.z(), 1, 1e-12);
  EXPECT_GT(ratio.x(), 1);
  EXPECT_EQ(ratio.y(), 1);
  EXPECT_EQ(larger.atlas.texels, start.atlas.texels);
}

TEST(BlackBoxPlan, SpendsNoMoreThanItIsGiven) {
  AttackSettings settings;
  for (const int queries : {500, 2000, 2001})
    for (const int batch : {2, 8}) {
      settings.queries = queries, settings.batch = batch;
      const BlackBoxPlan plan = black_box_plan(settings, 3, 17, 24);
      const long spent = 4 * 24 + plan.generations * plan.samples * batch;
      EXPECT_LE(spent, queries);
      EXPECT_GT(spent + plan.samples * batch, queries);
    }
  settings.queries = 100;
  EXPECT_THAT(error_text<InputError>([&] { black_box_plan(settings, 3, 17, 24); }),
              testing::StartsWith("queries: 100: "));
}

/// A detector without gradients. It fails after a given number of passes.
class ScoresAlone : public test::Everywhere {
 public:
  static inline int calls_left = 0;
  Capabilities capabilities() const override {
    Capabilities can;
    can.has_gradients = false;
    return can;
  }
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    EXPECT_FALSE(keep);
    if (calls_left-- <= 0) throw Failure("detector", "died", "try again");
    return Everywhere::forward(input, threshold, keep);
  }
  SensorGradient backward(std::span<const double>) override {
    throw Failure("detector", "was asked for a gradient", "do not");
  }
};

AttackSettings black_box_settings(const test::TemporaryFolder& folder, const char* out, int queries) {
  AttackSettings settings = test::tiny_attack();
  settings.attack = AttackSearch::black_box;
  settings.data = folder / "data";
  settings.out = folder / out;
  settings.queries = queries;
  settings.checkpoint.steps = 3;
  settings.objective.lambda_fp = 0;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

TEST(BlackBox, LearnsFromScoresAndResumesToTheSameBits) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 5, true);
  ScoresAlone::calls_left = 1 << 30;
  const auto learn = [&](const char* out, int queries, const DetectorPool& detectors) {
    const AttackResult result = run_attack(black_box_settings(folder, out, queries), detectors);
    EXPECT_EQ(to_json(result).at("attack"), "black-box");
    return result.black_box.value();
  };
  const BlackBoxReport whole = learn("whole", 330, test::one_of<ScoresAlone>());
  EXPECT_LE(whole.queries, 330);
  EXPECT_GE(whole.generations, 8);
  for (const auto& start : whole.starts) EXPECT_LT(whole.loss, start.loss - 0.02) << fields_json(whole);
  const TexturedMesh learned = read_adversary(folder / "whole/adversary.glb");  // darker is better
  double mean = 0;
  for (const Vec3d& texel : learned.atlas.texels)
    mean += texel.mean() / static_cast<double>(learned.atlas.texels.size());
  EXPECT_LT(mean, 0.45);
  const std::string rows = read_file(folder / "whole/loss.csv");
  EXPECT_EQ(std::count(rows.begin(), rows.end(), '\n'), 1 + 3 + whole.generations * whole.samples);

  int deaths = 0;
  nlohmann::json parts;
  for (int life = 30; parts.is_null(); life += 25) {
    ScoresAlone::calls_left = life;
    try {
      parts = fields_json(learn("parts", 330, test::one_of<ScoresAlone>()));
    } catch (const Failure&) {
      ++deaths;
    }
    ASSERT_LT(deaths, 30);
  }
  EXPECT_GE(deaths, 3);
  EXPECT_EQ(parts, fields_json(whole));
  ScoresAlone::calls_left = 1 << 30;
  DetectorPool two = test::one_of<ScoresAlone>();  // two detectors in parallel, and a run that is prolonged
  two.push_back(std::make_unique<ScoresAlone>());
  EXPECT_LT(learn("longer", 150, two).generations, whole.generations);
  EXPECT_EQ(fields_json(learn("longer", 330, two)), fields_json(whole));
  for (const char* run : {"parts", "longer"})
    for (const char* file : {"adversary.glb", "loss.csv"})
      EXPECT_EQ(read_file(folder / run / file), read_file(folder / "whole" / file)) << run << " " << file;

  const auto file = folder / "parts/checkpoint.json";
  auto bad = read_json(file);
  bad["losses"][0] = "x";
  write_json(file, bad);
  EXPECT_THAT(error_text<InputError>([&] { learn("parts", 330, test::one_of<ScoresAlone>()); }),
              HasSubstr("losses"));
}

TEST(BlackBox, WhatDoesNotGoWithItIsRefusedInALine) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 5, true);
  ScoresAlone::calls_left = 1 << 30;
  const DetectorPool detectors = test::one_of<ScoresAlone>();
  const auto message_of = [&](const auto& change) {
    auto settings = black_box_settings(folder, "bad", 330);
    change(settings);
    return error_text<InputError>([&] { run_attack(settings, detectors); });
  };
  EXPECT_THAT(message_of([](AttackSettings& s) { s.target = AttackTarget::lidar; }),
              HasSubstr("target: lidar"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.target = AttackTarget::random; }),
              HasSubstr("target: random"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.until_plateau = 5; }), HasSubstr("until_plateau: 5"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.seconds = 5; }), HasSubstr("seconds: 5"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.queries = 10; }), HasSubstr("queries: 10"));
  for (const AttackSearch search : {AttackSearch::plain, AttackSearch::automatic})
    EXPECT_THAT(message_of([&](AttackSettings& s) { s.attack = search; }),
                testing::AllOf(HasSubstr("gives no gradient"), HasSubstr("--attack black-box")));
}

/// Reads the sweep alone.
class ReadsNoPicture : public test::Everywhere {
 public:
  Capabilities capabilities() const override { return {false, true, true, false}; }
};

TEST(SeesColours, ColoursThatReachNothingAreNotLearned) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 5, true);
  const Capabilities blind = ReadsNoPicture().capabilities(), both = test::Everywhere().capabilities();
  AttackSettings settings = black_box_settings(folder, "bad", 330);
  settings.parts = AttackParts::texture;
  EXPECT_FALSE(sees_colours(settings, blind));
  EXPECT_TRUE(sees_colours(settings, both));
  for (const AttackSearch search : {AttackSearch::plain, AttackSearch::automatic, AttackSearch::black_box}) {
    settings.attack = search;
    EXPECT_THAT(error_text<FieldError>([&] { run_attack(settings, test::one_of<ReadsNoPicture>()); }),
                testing::AllOf(testing::StartsWith("parts: texture"), HasSubstr("reads no picture")));
  }
  settings.attack = AttackSearch::plain;
  settings.target = AttackTarget::lidar;
  EXPECT_THAT(error_text<FieldError>([&] { run_attack(settings, test::one_of<test::Everywhere>()); }),
              testing::AllOf(testing::StartsWith("parts: texture"), HasSubstr("the target")));
  settings.simulation.lidar_effects.albedo = true;  // returns depend on the albedo
  EXPECT_TRUE(sees_colours(settings, blind));
  EXPECT_TRUE(sees_colours(settings, both));
}

}  // namespace
}  // namespace mirage
