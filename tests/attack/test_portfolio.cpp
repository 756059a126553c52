// --attack auto: gradient-free search over shapes, then candidates, of which the best on held-out vehicles is
// kept.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "attack/attack.h"
#include "attack/baseline.h"
#include "attack/checkpoint.h"
#include "attack/portfolio.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/json_fields.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::Everywhere;
using test::one_of;
using testing::HasSubstr;

AttackSettings auto_settings(const test::TemporaryFolder& folder, const char* out, int iterations) {
  AttackSettings settings = test::tiny_attack();
  settings.attack = AttackSearch::automatic;
  settings.data = folder / "data";
  settings.out = folder / out;
  settings.iterations = iterations;
  settings.validation_every = 2;
  settings.checkpoint.steps = 5;
  settings.vertex_rate = 0.02;
  settings.texel_rate = 0.4;
  settings.objective.lambda_fp = 0;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

TEST(AutoBudget, SpendsExactlyWhatItIsGiven) {
  for (const long generation : {0L, 10L, 37L})
    for (const std::size_t candidates : {1u, 2u, 4u, 5u, 12u})
      for (const long iterations : {120L, 121L, 1000L, 4096L}) {
        const AutoBudget budget = auto_budget(iterations, candidates, generation);
        long spent = budget.search, end = 0;
        for (std::size_t r = 0; r < budget.rounds.size(); ++r) {
          const auto& round = budget.rounds[r];
          spent += round.steps * static_cast<long>(round.candidates);
          end += round.steps;
          EXPECT_GT(round.steps, 0);
          const std::size_t before = r > 0 ? budget.rounds[r - 1].candidates : 2 * candidates;
          EXPECT_EQ(round.candidates, (before + 1) / 2);
        }
        EXPECT_EQ(spent, iterations);
        EXPECT_EQ(end, budget.longest());
        EXPECT_EQ(budget.rounds.back().candidates, 1u);
        EXPECT_LE(budget.search, iterations / 4);
        EXPECT_EQ(budget.generations > 0, generation > 0 && iterations >= 4 * generation);
        EXPECT_EQ(budget.search, budget.generations * generation);
      }
  EXPECT_EQ(auto_budget(24, 4, 0).rounds.front().steps, 2);
  EXPECT_THAT(error_text<InputError>([] { auto_budget(7, 4, 0); }), testing::StartsWith("iterations: 7: "));
}

TEST(AutoTargets, AreThoseThatTheDetectorsSensorsAllow) {
  using enum AttackTarget;
  const Capabilities fusion{true, true, false, false}, one = test::PictureStandIn().capabilities();
  EXPECT_THAT(auto_targets(both, fusion), testing::ElementsAre(both, lidar, image));
  EXPECT_THAT(auto_targets(image, fusion), testing::ElementsAre(image));
  EXPECT_THAT(auto_targets(both, one), testing::ElementsAre(both));
}

/// Less certain of the car the more returns lie above its roof; no gradient shows that.
class Counting : public Everywhere {
 public:
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient none = Everywhere::backward(d_logits);
    for (float& d : none.image.data) d = 0;
    for (auto& d : none.points) d = {};
    return none;
  }

 protected:
  double logit(const SensorView& input, double) const override {
    const auto high = std::count_if(input.points.begin(), input.points.end(),
                                    [](const LidarPoint& p) { return p.z > -0.2f; });
    return 3 - 0.002 * static_cast<double>(high);
  }
};

TEST(Auto, TheStartThatHidesMostIsKeptWhereNoGradientHelps) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 6, true);
  auto settings = auto_settings(folder, "run", 240);
  settings.objective.lambda_laplacian = 0;
  const AutoReport report = run_attack(settings, one_of<Counting>()).automatic.value();
  std::string lowest;
  double value = 1e9, paper = 0;
  for (const AutoReport::Start& start : report.starts) {
    if (start.name == "paper") paper = start.held_out;
    if (start.held_out < value) value = start.held_out, lowest = start.name;
  }
  EXPECT_GT(report.search.generations, 0);
  EXPECT_LT(value, paper - 0.01) << fields_json(report);
  const AutoReport::Candidate& chosen = report.candidates.at(report.chosen);
  EXPECT_EQ(chosen.start, lowest);
  EXPECT_EQ(chosen.held_out, value);
  EXPECT_EQ(report.steps, 240);
  std::vector<std::string>
      starts;  // the paper's start and the best of the others; each has one candidate in the second round
  std::multiset<std::string> second;
  for (const AutoReport::Candidate& candidate : report.candidates) {
    starts.push_back(candidate.start);
    if (candidate.rounds >= 2) second.insert(starts.back());
  }
  EXPECT_THAT(starts, testing::Contains("paper"));
  EXPECT_THAT(starts, testing::Contains(lowest));
  for (const std::string& start : starts) EXPECT_THAT(start, testing::AnyOf("paper", lowest));
  EXPECT_EQ(second.count("paper"), second.count(lowest));
  // The mesh is that start, and other commands can read it.
  const Vec3d size = bounds(read_run(folder / "run").adversary.mesh).sizes();
  EXPECT_GT(size.x(), 1.2) << size.transpose();  // the paper's is 1.2 long
}

/// Its gradient through the picture has the wrong sign.
class Misled : public Everywhere {
 public:
  SensorGradient backward(std::span<const double> d_logits) override {
    SensorGradient gradient = Everywhere::backward(d_logits);
    for (float& d : gradient.image.data) d *= -1;
    return gradient;
  }
};

TEST(Auto, TheCandidateThatMustWinWins) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 6, true);
  auto settings = auto_settings(folder, "run", 60);
  settings.parts = AttackParts::texture;  // every candidate has the same shape: returns do not change
  settings.objective.lambda_laplacian = 0;
  const AutoReport misled = run_attack(settings, one_of<Misled>()).automatic.value();
  settings.out = folder / "right";
  const AutoReport right = run_attack(settings, one_of<Everywhere>()).automatic.value();
  const auto chosen = [](const AutoReport& report) { return report.candidates.at(report.chosen); };
  // Misled, no texture step helps; otherwise an attack on the picture at the larger rate gets furthest.
  EXPECT_EQ(chosen(misled).kept_iteration, 0);
  EXPECT_GT(chosen(right).kept_iteration, 0);
  EXPECT_NE(chosen(right).target, AttackTarget::lidar);
  EXPECT_EQ(chosen(right).texel_rate, settings.texel_rate);
  EXPECT_LT(chosen(right).held_out, chosen(misled).held_out);
  double lowest = 1e9;
  std::set<long> steps;
  for (const AutoReport::Candidate& candidate : right.candidates) {
    lowest = std::min(lowest, candidate.held_out);
    steps.insert(candidate.steps);
  }
  EXPECT_EQ(chosen(right).held_out, lowest);
  EXPECT_GT(steps.size(), 2u);  // successive halving: some candidates went further than others
  // The written mesh is the candidate's best.
  const auto file = folder / ("right/auto/candidate-" + std::to_string(right.chosen) + ".json");
  const auto held = read_json(file).at("held_out").at("texels").get<std::vector<double>>();
  const auto texels = read_run(folder / "right").adversary.atlas.texels;
  ASSERT_EQ(held.size(), 3 * texels.size());
  for (std::size_t i = 0; i < texels.size(); ++i) EXPECT_EQ(texels[i].x(), held[3 * i]);
}

// Each candidate has its own seed, but is judged in the same sampled environments.
TEST(Auto, CandidatesAreJudgedInTheSameWorlds) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 6, true);
  auto settings = auto_settings(folder, "run", 60);
  settings.parts = AttackParts::texture;
  settings.expectation = parse_expectation("shape:0.05,colour");
  const AutoReport report = run_attack(settings, one_of<Everywhere>()).automatic.value();
  std::map<std::string, double> starts;
  for (const AutoReport::Start& start : report.starts) starts[start.name] = start.held_out;
  ASSERT_GT(report.candidates.size(), 2u);
  EXPECT_NE(report.candidates[0].seed, report.candidates[1].seed);
  for (std::size_t i = 0; i < report.candidates.size(); ++i) {
    const auto file = folder / ("run/auto/candidate-" + std::to_string(i) + ".json");
    const auto values = read_json(file).at("held_out").at("values").get<std::vector<double>>();
    EXPECT_EQ(values.front(), starts.at(report.candidates[i].start)) << i;  // before any of its own steps
  }
}

/// Fails in the middle of its work, like a killed program.
class Mortal : public Everywhere {
 public:
  static inline int calls_left = 0;
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    if (calls_left-- <= 0) throw Failure("detector", "died", "try again");
    return Everywhere::forward(input, threshold, keep);
  }
};

TEST(Auto, ResumesToTheSameBits) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 5, true);
  Mortal::calls_left = 1 << 30;
  const auto report = [](const AttackSettings& settings, const DetectorPool& detectors) {
    return to_json(run_attack(settings, detectors)).at("auto");
  };
  const nlohmann::json whole = report(auto_settings(folder, "whole", 100), one_of<Mortal>());
  int deaths = 0;
  nlohmann::json parts;
  for (int life = 60; parts.is_null(); life += 20) {
    Mortal::calls_left = life;
    try {
      parts = report(auto_settings(folder, "parts", 100), one_of<Mortal>());
    } catch (const Failure&) {
      ++deaths;
    }
    ASSERT_LT(deaths, 100);
  }
  EXPECT_GE(deaths, 3);
  EXPECT_EQ(parts, whole);
  for (const char* file : {"adversary.glb", "loss.csv", "run.json", "auto/looks.json", "checkpoint.json"})
    EXPECT_EQ(read_file(folder / "parts" / file), read_file(folder / "whole" / file)) << file;
  // Also on two detectors at once; and a finished run does not start again.
  DetectorPool two = one_of<Everywhere>();
  two.push_back(std::make_unique<Everywhere>());
  EXPECT_EQ(report(auto_settings(folder, "two", 100), two), whole);
  EXPECT_EQ(read_file(folder / "two/adversary.glb"), read_file(folder / "whole/adversary.glb"));
  // A run with another budget is another run, and so is a plain attack.
  EXPECT_THAT(error_text<InputError>(
                  [&] { run_attack(auto_settings(folder, "whole", 110), one_of<test::StandInDetector>()); }),
              HasSubstr("iterations"));
  auto plain = auto_settings(folder, "whole", 100);
  plain.attack = AttackSearch::plain;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(plain, one_of<test::StandInDetector>()); }),
              HasSubstr("attack"));
  // A damaged record is refused, and the error names the field.
  const auto file = folder / "parts/auto/looks.json";
  auto bad = read_json(file);
  bad["shapes"][0] = "x";
  write_json(file, bad);
  EXPECT_THAT(error_text<InputError>(
                  [&] { run_attack(auto_settings(folder, "parts", 100), one_of<test::StandInDetector>()); }),
              HasSubstr("shapes"));
}

TEST(Auto, NeverLooksAtTestVehicles) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 6, true);
  run_attack(auto_settings(folder, "before", 120), one_of<Everywhere>());
  const auto run = read_json(folder / "before/run.json");
  ASSERT_GT(run.at("test").size(), 0u);
  EXPECT_FALSE(run.at("validation").empty());
  for (const auto& host : run.at("validation")) EXPECT_THAT(run.at("train"), testing::Contains(host));
  const std::string other = run.at("train").at(0).at("frame");
  for (const auto& host : run.at("test"))  // sensor data of the test frames change
    for (const char* file : {"image_2/X.png", "velodyne/X.bin"}) {
      const auto path = [&](std::string frame) {
        std::string name = file;
        return folder / "data/training" / name.replace(name.find('X'), 1, frame);
      };
      std::filesystem::copy_file(path(other), path(host.at("frame")),
                                 std::filesystem::copy_options::overwrite_existing);
    }
  run_attack(auto_settings(folder, "after", 120), one_of<Everywhere>());
  EXPECT_EQ(read_json(folder / "after/run.json").at("test"), run.at("test"));
  EXPECT_EQ(read_file(folder / "after/adversary.glb"), read_file(folder / "before/adversary.glb"));
}

TEST(Auto, WhatDoesNotGoWithItIsRefusedInALine) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 6, true);
  const DetectorPool detectors = one_of<test::StandInDetector>();
  const auto message_of = [&](const auto& change) {
    auto settings = auto_settings(folder, "bad", 60);
    change(settings);
    return error_text<InputError>([&] { run_attack(settings, detectors); });
  };
  EXPECT_THAT(message_of([](AttackSettings& s) { s.target = AttackTarget::random; }),
              HasSubstr("target: random"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.until_plateau = 5; }), HasSubstr("until_plateau: 5"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.seconds = 5; }), HasSubstr("seconds: 5"));
  EXPECT_THAT(message_of([](AttackSettings& s) { s.iterations = 3; }),
              testing::StartsWith("iterations: 3: "));
  test::TemporaryFolder few;
  test::write_tiny_data(few / "data", 2, true);  // one training frame: none is left for validation
  EXPECT_THAT(error_text<InputError>([&] { run_attack(auto_settings(few, "bad", 60), detectors); }),
              testing::StartsWith("attack: 1 training frame: "));
  auto plain = auto_settings(folder, "plain", 1);
  plain.attack = AttackSearch::plain;
  const AttackResult result = run_attack(plain, detectors);
  EXPECT_FALSE(result.automatic);
  EXPECT_FALSE(to_json(result).contains("auto"));
  EXPECT_EQ(read_json(folder / "plain/run.json").at("attack"), "plain");
}

}  // namespace
}  // namespace mirage
