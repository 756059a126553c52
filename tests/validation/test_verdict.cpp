// Verdict, summary and budget over made-up results of vehicles.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <stdexcept>

#include "base/error.h"
#include "base/random.h"
#include "base/sizes.h"
#include "fixture.h"
#include "validation/fidelity/budget.h"
#include "validation/fidelity/ladders.h"
#include "validation/fidelity/summary.h"
#include "validation/fidelity/validate.h"
#include "validation/paper/finding.h"

namespace mirage {
namespace {

using nlohmann::json;

OutcomeResult outcome(double score, bool hidden, bool false_positive = false) {
  return {hidden ? 0.2 : 0.9, score, 0, hidden, false_positive};
}

VehicleResult vehicle(const std::string& frame, int label, bool detected, const OutcomeResult& soft,
                      const OutcomeResult& cycles) {
  VehicleResult vehicle;
  vehicle.host = {frame, label};
  vehicle.name = host_name(vehicle.host);
  SeenResult& seen = vehicle.seen.emplace();
  seen.range = 12.5;
  seen.detected = detected;
  seen.clean = {0.9, 0.9};
  seen.raster = seen.hard = soft;
  seen.cycles = cycles;
  return vehicle;
}

const VerdictVariant& variant(const VerdictGroup& group, const std::string& name) {
  for (const VerdictVariant& v : group.variants)
    if (v.name == name) return v;
  throw std::out_of_range(name);
}

TEST(Verdict, CountsSharesFlipsAndSplits) {
  const auto hidden = outcome(0.1, true), found = outcome(0.8, false), false_box = outcome(0.7, false, true);
  VehicleResult unseen;
  unseen.host = {"c", 1};
  std::vector<VehicleResult> vehicles;
  vehicles.push_back(vehicle("a", 0, true, hidden, hidden));
  vehicles.push_back(vehicle("a", 1, true, hidden, found));
  vehicles.push_back(vehicle("b", 0, true, found, false_box));
  vehicles.push_back(vehicle("b", 1, false, found, hidden));
  vehicles.push_back(vehicle("c", 0, true, found, found));
  vehicles.push_back(unseen);
  LightRungResult shadows;
  shadows.effect = "+shadows", shadows.outcome = hidden;
  vehicles[0].seen->ladder.emplace().light = {shadows};
  const Verdict result = verdict(vehicles, {"a", "b"});
  const VerdictGroup &held_back = result.held_back, &all = result.all;
  EXPECT_EQ(held_back.vehicles, 3);
  EXPECT_EQ(all.vehicles, 4);
  EXPECT_NEAR(variant(held_back, "soft").fn_asr.value, 2 / 3.0, 1e-12);
  EXPECT_NEAR(variant(held_back, "cycles").fn_asr.value, 1 / 3.0, 1e-12);
  EXPECT_NEAR(variant(held_back, "cycles").asr.value, 2 / 3.0, 1e-12);
  EXPECT_NEAR(variant(all, "cycles").fp_asr.value, 0.25, 1e-12);
  EXPECT_EQ(variant(all, "+shadows").vehicles, 1);
  EXPECT_NEAR(all.difference.fn_asr.value, -0.25, 1e-12);
  EXPECT_NEAR(all.difference.asr.value, 0, 1e-12);
  EXPECT_LE(all.difference.asr.low, 0);
  EXPECT_NEAR(all.agree, 0.5, 1e-12);
  EXPECT_EQ(result.pairs.size(), 5u);
  ASSERT_EQ(result.flips.size(), 1u);  // a vehicle that is not found clean has no outcome to flip
  const json flip = to_json(result).at("flips").at(0);
  EXPECT_EQ(flip.at("name"), "a_1");
  EXPECT_EQ(flip.at("split"), "test");
  EXPECT_EQ(flip.at("from"), "hidden");
  EXPECT_EQ(flip.at("to"), "found");
}

TEST(Verdict, VariantsStandInTheOrderOfTheLadder) {
  const auto found = outcome(0.8, false);
  std::vector<VehicleResult> vehicles{vehicle("a", 0, true, found, found),
                                      vehicle("a", 1, true, found, found)};
  LightRungResult soft, shadows, all;
  soft.effect = "soft", shadows.effect = "+shadows", all.effect = "all";
  soft.outcome = shadows.outcome = all.outcome = found;
  vehicles[1].seen->ladder.emplace().light = {soft, shadows, all};  // after a vehicle without a ladder
  std::vector<std::string> names;
  const json written = to_json(verdict(vehicles, {}));
  for (const json& of : written.at("all").at("variants")) names.push_back(of.at("name"));
  EXPECT_EQ(names, (std::vector<std::string>{"soft", "hard", "+shadows", "all", "cycles"}));
}

TEST(Verdict, IntervalsAreByVehicleWhereItIsKnown) {
  std::vector<VehicleResult> vehicles;
  for (int i = 0; i < 40; ++i)
    vehicles.push_back(vehicle(std::to_string(i), 0, true, outcome(i < 10 ? 0.1 : 0.8, i < 10),
                               outcome(i < 10 ? 0.1 : 0.8, i < 10)));
  const VerdictGroup apart = verdict(vehicles, {}).all;
  EXPECT_EQ(to_json(apart.clusters), (json{{"by", "frame"}, {"count", 40}}));
  for (int i = 0; i < 40; ++i) vehicles[as_size(i)].track = i / 10;
  const VerdictGroup together = verdict(vehicles, {}).all;
  EXPECT_EQ(to_json(together.clusters), (json{{"by", "vehicle"}, {"count", 4}}));
  EXPECT_EQ(variant(together, "soft").asr.value, 0.25);
  EXPECT_LT(variant(together, "soft").asr.low, 0.05);
  EXPECT_GT(variant(apart, "soft").asr.low, 0.1);
}

TEST(Verdict, NoVehiclesAtAll) {
  const Verdict result = verdict({}, {});
  EXPECT_EQ(result.all.vehicles, 0);
  EXPECT_FALSE(result.all.score_correlation);
  EXPECT_TRUE(to_json(result).at("all").at("score_correlation").is_null());
  EXPECT_EQ(to_json(result).at("of"), "all");
  EXPECT_EQ(to_json(summarize_vehicles({}, {})).at("vehicles"), 0);
}

TEST(Summary, ATargetIsOpenWhereNothingWasMeasured) {
  ValidationSummary summary;
  summary.cameras.push_back({"SIDE", 1, {}});
  for (const Target& target : targets_of(summary)) EXPECT_FALSE(target.met.has_value()) << target.place;
  summary.matched.mask_either = 10;
  summary.matched.rays = 5;
  const auto met = [&](const char* place) {
    for (const Target& target : targets_of(summary))
      if (target.place == place) return target.met;
    return std::optional<bool>();
  };
  EXPECT_EQ(met("matched.mask_iou"), true);
  EXPECT_EQ(met("matched.hit_disagreements"), true);
  EXPECT_FALSE(met("matched.range_error_m").has_value());  // no return
  Validation validation;
  EXPECT_NE(headline(validation).find("measured nothing for 4 of 4 targets"), std::string::npos);
  EXPECT_TRUE(to_json(validation).at("targets").at(0).at("met").is_null());
}

TEST(Summary, ARungsFiguresStandUnderTheFilesNames) {
  std::vector<VehicleResult> vehicles(2);
  for (VehicleResult& of : vehicles) {
    LightRungResult light;
    light.effect = "soft", light.group = "raster", light.base = "hard", light.seconds = 2;
    light.change.psnr = vehicles.data() == &of ? 30 : HUGE_VAL;  // equal pictures do not count
    light.crop.psnr = HUGE_VAL, light.to_full.relative = 0.5;
    LadderResult& ladder = of.seen.emplace().ladder.emplace();
    ladder.light = {light};
    ladder.lidar = {{"noise", vehicles.data() == &of ? 7 : 8, 0.5, -0.25, 0.125, outcome(0.4, true)}};
    of.seen->raster = outcome(0.5, false);
  }
  const json summary = to_json(summarize_vehicles(vehicles, {}));
  const json &light = summary.at("ladder").at(0), &lidar = summary.at("lidar_ladder").at(0);
  const std::set<std::string> common{"effect", "vehicles", "detected",   "hidden",       "false_positive",
                                     "fn_asr", "asr",      "mean_score", "score_change", "seconds"};
  const auto names_beside = [&](const json& rung) {
    std::set<std::string> names;
    for (const auto& [name, value] : rung.items())
      if (!common.contains(name)) names.insert(name);
    EXPECT_EQ(rung.size(), common.size() + names.size());
    return names;
  };
  EXPECT_EQ(names_beside(light),
            (std::set<std::string>{"mae", "relative", "ssim", "flip", "psnr", "crop", "to_full", "group",
                                   "base", "error_plain", "floor", "error_drawn", "error_unbiased",
                                   "interval", "interval_over"}));
  EXPECT_EQ(names_beside(lidar), (std::set<std::string>{"returns", "changed", "returns_change", "logit"}));
  EXPECT_EQ(light.at("psnr"), 30);
  EXPECT_FALSE(light.at("crop").contains("psnr"));
  EXPECT_EQ(light.at("to_full").at("relative"), 0.5);
  EXPECT_EQ(light.at("seconds"), 2);
  EXPECT_EQ(lidar.at("returns"), 7.5);
  EXPECT_EQ(lidar.at("hidden"), 2);
  EXPECT_NEAR(lidar.at("score_change").get<double>(), 0.1, 1e-12);
}

/// Scenes with errors that follow a feature. Rung 0 is free and accurate for small x; rung 1 costs 1 and is
/// accurate except for large y.
std::vector<BudgetScene> scenes_of(int frames, std::uint64_t seed, double noise) {
  std::vector<BudgetScene> scenes;
  RandomStream random(seed, "budget test");
  for (int f = 0; f < frames; ++f)
    for (int k = 0; k < 3; ++k) {
      BudgetScene scene;
      scene.frame = scene.group = std::to_string(f);
      scene.name = scene.frame + "_" + std::to_string(k);
      const double x = random.normal(), y = random.normal();
      scene.features = {x, y, 7};  // the third carries no information
      scene.errors = {0.05 * std::exp(x + noise * random.normal()),
                      0.02 * std::exp(0.5 * y + noise * random.normal())};
      scene.seconds = scene.alone = {0, 1};
      scene.seconds_full = 10;
      scenes.push_back(scene);
    }
  return scenes;
}

TEST(Budget, KeepsTheRiskOnFramesItNeverSaw) {
  int beyond = 0, total = 0, cheap = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const BudgetRule rule(scenes_of(30, seed, 0.3), 0.05, 0.9);
    for (const BudgetScene& scene : scenes_of(30, seed + 1000, 0.3)) {
      const int rung = rule.choose(scene.features);
      ++total;
      beyond += rung >= 0 && scene.errors[as_size(rung)] > 0.05;
      cheap += rung >= 0;
    }
  }
  EXPECT_LE(beyond, 0.1 * total);
  EXPECT_GE(cheap, 0.7 * total);  // and it does not just always take the dearest rung
}

TEST(Budget, ChoosesByTheFeatureThatMatters) {
  const BudgetRule rule(scenes_of(40, 3, 0.01), 0.05, 0.9);
  EXPECT_EQ(rule.choose({-1.5, 0, 7}), 0);
  EXPECT_EQ(rule.choose({1.5, 0, 7}), 1);
  EXPECT_EQ(rule.choose({1.5, 4, 7}), -1);
}

TEST(Budget, OneRungForAllWhereItIsBackedAndCheaper) {
  std::vector<BudgetScene> scenes = scenes_of(40, 3, 0.01);
  for (BudgetScene& scene : scenes) {
    scene.errors[1] = 0.03;  // within the budget everywhere
    scene.alone = {0, 1};
    scene.seconds = {5, 6};  // the features cost more than the rendering
  }
  EXPECT_EQ(BudgetRule(scenes, 0.05, 0.9).always(), 1);
  for (BudgetScene& scene : scenes) scene.seconds = {0, 1};  // free features: rung 0 does for some
  EXPECT_EQ(BudgetRule(scenes, 0.05, 0.9).always(), std::nullopt);
  for (BudgetScene& scene : scenes) scene.seconds = {5, 6};
  for (std::size_t i = 0; i < scenes.size(); i += 3) scenes[i].errors[1] = 0.06;  // a third of every group
  EXPECT_EQ(BudgetRule(scenes, 0.05, 0.9).always(), std::nullopt);
}

TEST(Budget, TooFewGroupsTrustNothing) {
  // (0 + 1) / (8 + 1) > 0.1: no choice has enough evidence.
  const BudgetRule rule(scenes_of(8, 3, 0.01), 0.05, 0.9);
  EXPECT_EQ(rule.choose({-3, -3, 7}), -1);
  EXPECT_TRUE(to_json(rule).at("lambda").is_null());
  EXPECT_EQ(BudgetRule(scenes_of(1, 3, 0.01), 0.05, 0.9).choose({-3, -3, 7}), -1);
}

/// Results of vehicles with two rungs, "hard" and "full".
std::vector<VehicleResult> vehicles_of(const std::vector<BudgetScene>& scenes) {
  std::vector<VehicleResult> vehicles;
  for (const BudgetScene& scene : scenes) {
    VehicleResult vehicle;
    vehicle.host.frame = scene.frame;
    vehicle.name = scene.name;
    vehicle.seen.emplace().detected = true;
    LadderResult& ladder = vehicle.seen->ladder.emplace();
    ladder.reference = {0, 10, 0.01};
    ladder.features = {{"x", scene.features[0]}, {"y", scene.features[1]}};
    for (const auto& [effect, k] : {std::pair("hard", 0), std::pair("full", 1)}) {
      LightRungResult rung;
      rung.effect = effect;
      rung.group = k == 0 ? "raster" : "samples";
      rung.seconds = k == 0 ? 0.01 : 1.0;
      const double error = scene.errors[as_size(k)];
      rung.error.drawn = error * error;
      ladder.light.push_back(std::move(rung));
    }
    vehicles.push_back(std::move(vehicle));
  }
  return vehicles;
}

TEST(Budget, KeepsItsPromiseOnGroupsThatItLeavesOut) {
  const std::vector<VehicleResult> vehicles = vehicles_of(scenes_of(40, 5, 0.1));
  const BudgetReport report = choose_rungs(vehicles, {.budget = 0.05});
  const json result = to_json(report);
  EXPECT_EQ(result.at("groups"), (json{{"by", "frame"}, {"count", 40}, {"folds", 20}}));
  EXPECT_EQ(result.at("features"), (json{"x", "y"}));
  EXPECT_EQ(result.at("rungs").at(1).at("name"), "full");
  ASSERT_TRUE(report.test);
  const BudgetTest& test = *report.test;
  EXPECT_EQ(test.frames, 40);
  EXPECT_EQ(test.vehicles, 120);
  EXPECT_GT(test.ruled.within.value, 0.85);
  EXPECT_EQ(test.kept, test.ruled.within.value >= 0.9);
  // Savings are relative to the one rung that keeps the budget everywhere, not to the reference.
  EXPECT_EQ(test.fixed.chosen, (std::map<std::string, int>{{"full", 120}}));
  double ruled = 0, fixed = 0;
  std::map<std::string, std::set<int>> folds;
  ASSERT_EQ(result.at("scenes").size(), 120u);
  for (const json& scene : result.at("scenes")) {
    ruled += scene.at("seconds").get<double>();
    fixed += scene.at("seconds_fixed").get<double>();
    folds[scene.at("group").get<std::string>()].insert(scene.at("fold").get<int>());
    if (scene.at("chosen") == "reference") {
      EXPECT_EQ(scene.at("error"), 0.01);
    }
  }
  EXPECT_NEAR(fixed, 120, 1e-9);
  EXPECT_NEAR(result.at("test").at("saved").get<double>(), 1 - ruled / fixed, 1e-9);
  EXPECT_GT(result.at("test").at("oracle").at("saved"), 0.2);
  for (const auto& [group, of] : folds) EXPECT_EQ(of.size(), 1u) << group;
  EXPECT_EQ(to_json(choose_rungs(vehicles, {.budget = 0.05})), result);
  EXPECT_TRUE(to_json(choose_rungs({}, {})).contains("problem"));
  EXPECT_THROW(parse_word<BudgetOf>("colour", "budget_of"), FieldError);
}

TEST(Budget, WhatIsChosenForAGroupDoesNotDependOnItsErrors) {
  // Frames 0 to 4 show one vehicle: one drive. In the second run its errors are ten times as large.
  std::vector<VehicleResult> vehicles = vehicles_of(scenes_of(15, 7, 0.1));
  for (VehicleResult& vehicle : vehicles)
    if (std::stoi(vehicle.host.frame) < 5) vehicle.track = 77;
  const BudgetReport before = choose_rungs(vehicles, {.budget = 0.05});
  EXPECT_EQ(to_json(before).at("groups"), (json{{"by", "vehicle"}, {"count", 11}, {"folds", 11}}));
  for (VehicleResult& vehicle : vehicles)
    if (vehicle.track >= 0)
      for (LightRungResult& rung : vehicle.seen->ladder->light) rung.error.drawn *= 100;
  const BudgetReport after = choose_rungs(vehicles, {.budget = 0.05});
  const auto chosen = [](const BudgetReport& report) {
    std::map<std::string, std::string> of;
    for (const BudgetChoice& scene : report.test->scenes)
      if (std::stoi(scene.frame) < 5) of[scene.name] = scene.chosen;
    return of;
  };
  EXPECT_EQ(chosen(before).size(), 15u);
  EXPECT_EQ(chosen(before), chosen(after));
  EXPECT_LT(after.test->ruled.within.value, before.test->ruled.within.value);
}

TEST(Budget, FramesThatShareAVehicleAreOneGroup) {
  const auto groups =
      linked_frames({{"a", {1, -1}}, {"b", {2}}, {"c", {1, 3}}, {"d", {-1}}, {"e", {3}}, {"f", {-1}}});
  EXPECT_EQ(groups, (std::map<std::string, std::string>{
                        {"a", "a"}, {"b", "b"}, {"c", "a"}, {"d", "d"}, {"e", "a"}, {"f", "f"}}));
}

}  // namespace
}  // namespace mirage

namespace mirage::paper {

// When a claim about a difference holds: one rule, its family, and the number of vehicles that would decide.

namespace {

constexpr Verdict kHolds = Verdict::holds, kFails = Verdict::fails, kOpen = Verdict::open;
constexpr double kInf = std::numeric_limits<double>::infinity();

struct IntervalCase {
  Interval d;
  Verdict more, no_less, no_help;
};

// The margin is 5 points.
const IntervalCase kCases[] = {
    {{0.10, 0.02, 0.20}, kHolds, kHolds, kOpen},       // more; whether by 5 points is open
    {{0.10, 0.06, 0.20}, kHolds, kHolds, kFails},      // more, by more than the margin
    {{0.025, 0.01, 0.04}, kHolds, kHolds, kHolds},     // more, and of no help: both are true
    {{0.00, -0.04, 0.04}, kOpen, kHolds, kHolds},      // within the margin on both sides
    {{-0.025, -0.04, -0.01}, kFails, kHolds, kHolds},  // less, by less than the margin
    {{-0.04, -0.08, -0.01}, kFails, kOpen, kHolds},    // less; whether by the margin is open
    {{-0.10, -0.20, -0.06}, kFails, kFails, kHolds},  {{0.00, -0.06, 0.06}, kOpen, kOpen, kOpen},
    {{0.10, -0.02, 0.20}, kOpen, kHolds, kOpen},      {{-0.10, -0.20, 0.02}, kOpen, kOpen, kHolds},
    {{0.00, 0.00, 0.10}, kOpen, kHolds, kOpen},  // an end on the bound decides nothing
    {{-0.02, -0.05, 0.00}, kOpen, kOpen, kHolds},     {{0.05, 0.05, 0.05}, kHolds, kHolds, kOpen},
    {{0.10, -kInf, kInf}, kOpen, kOpen, kOpen},
};

TEST(Verdicts, OneTableOfIntervals) {
  for (const IntervalCase& one : kCases) {
    const std::string text = testing::PrintToString(one.d.low) + " to " + testing::PrintToString(one.d.high);
    EXPECT_EQ(judge(Claim::more, one.d), one.more) << text;
    EXPECT_EQ(judge(Claim::no_less, one.d), one.no_less) << text;
    EXPECT_EQ(judge(Claim::no_help, one.d), one.no_help) << text;
  }
}

TEST(Verdicts, ClaimsAboutOneDifferenceAgree) {
  int seen = 0;
  for (int low = -12; low <= 12; ++low)
    for (int high = low; high <= 12; ++high) {
      const Interval d{0.005 * (low + high), 0.01 * low, 0.01 * high};
      const Interval back{-d.value, -d.high, -d.low};
      if (judge(Claim::more, d) == kHolds) {
        EXPECT_EQ(judge(Claim::no_less, d), kHolds);
      }
      if (judge(Claim::no_less, d) == kFails) {
        EXPECT_EQ(judge(Claim::more, d), kFails);
      }
      EXPECT_EQ(judge(Claim::no_help, d),
                judge(Claim::no_less, back));  // with the sign reversed, no help is no less
      EXPECT_FALSE(judge(Claim::more, d) == kHolds && judge(Claim::more, back) == kHolds);
      EXPECT_FALSE(judge(Claim::no_help, d) == kFails &&
                   judge(Claim::more, d) != kHolds);  // if it helps, it is more
      // The p-value is below 0.05 exactly where the verdict is decided.
      for (const Claim claim : {Claim::more, Claim::no_less, Claim::no_help})
        if (low < high) {
          EXPECT_EQ(p_value(claim, d) < 0.05, judge(claim, d) != kOpen) << low << " " << high;
        }
      ++seen;
    }
  EXPECT_EQ(seen, 25 * 26 / 2);
}

TEST(Verdicts, SeveralTogether) {
  EXPECT_EQ(all_of({kHolds, kOpen}), kOpen);
  EXPECT_EQ(all_of({kHolds, kOpen, kFails}), kFails);
  EXPECT_EQ(all_of({kHolds, kHolds}), kHolds);
  EXPECT_EQ(all_of({}), kOpen);
}

TEST(Verdicts, PValuesAreThoseOfANormalDifference) {
  // Standard error 0.01: the interval is ± 1.96 of it.
  const auto at = [](double z) { return Interval{0.01 * z, 0.01 * (z - 1.959964), 0.01 * (z + 1.959964)}; };
  EXPECT_NEAR(p_value(Claim::more, at(1.959964)), 0.05, 1e-6);
  EXPECT_NEAR(p_value(Claim::more, at(-2.575829)), 0.01, 1e-6);
  EXPECT_NEAR(p_value(Claim::no_less, at(-5 + 3.290527)), 0.001, 1e-6);  // the bound is 5 of them below 0
  EXPECT_EQ(p_value(Claim::more, at(0)), 1);
  EXPECT_EQ(p_value(Claim::more, {0.1, -kInf, kInf}), 1);
  EXPECT_EQ(p_value(Claim::more, {0.1, 0.1, 0.1}), 0);
}

TEST(Verdicts, PValuesOfFewClustersAreThoseOfStudentsT) {
  // Four degrees of freedom: 95 % lie within 2.776445 standard errors, 99 % within 4.604095, 99.9 % within
  // 8.610302 (tables of Student's t).
  const auto at = [](double t) { return Interval{t, t - 2.776445, t + 2.776445}; };
  EXPECT_NEAR(p_value(Claim::more, at(2.776446), 5), 0.05, 1e-6);
  EXPECT_NEAR(p_value(Claim::more, at(-4.604095), 5), 0.01, 1e-6);
  EXPECT_NEAR(p_value(Claim::more, at(8.610302), 5), 0.001, 1e-6);
  EXPECT_EQ(p_value(Claim::more, at(100), 1), 1);  // with one cluster nothing is known
  // A family of ten with one at 4.7 standard errors: with a normal tail (p = 0.0009) it would be decided.
  std::vector<Comparison> ten(10, comparison("", {{0, -2.776445, 2.776445}, 5}));
  ten[0] = comparison("", {at(4.7), 5});
  EXPECT_EQ(ten[0].verdict, kHolds);
  std::vector<Comparison*> family;
  for (Comparison& one : ten) family.push_back(&one);
  correct(family);
  EXPECT_EQ(ten[0].verdict, kOpen);
  EXPECT_NEAR(ten[0].p_family, 0.0933, 1e-3);
  // (t(1 − 0.005/2) + t(0.8)) / 4.7, with t of four degrees: (5.597568 + 0.940965) / 4.7, squared.
  EXPECT_EQ(vehicles_needed(ten[0], 100), 200);
}

TEST(Verdicts, ADifferenceKnowsTheClustersOfItsInterval) {
  paper::Outcomes a, b;
  for (int i = 0; i < 12; ++i) {
    paper::Outcome host;
    host.id = {"00000" + std::to_string(i % 6), i};
    host.detected = true;
    host.hidden = i % 2 == 0;
    a.hosts.push_back(host);
    host.hidden = i % 3 == 0;
    b.hosts.push_back(host);
  }
  EXPECT_EQ(paper::difference(a, b, paper::question("fn_asr")).clusters, 6);
}

TEST(Verdicts, HolmsCorrectionOpensWhatIsTooWeakForTheFamily) {
  const auto with_p = [](double z) { return comparison("", {z, z - 1.959964, z + 1.959964}); };
  // p = 0.0027, 0.0124, 0.0193, 0.5: against 0.05 / 4, / 3, / 2, / 1.
  std::vector<Comparison> four = {with_p(2.34), with_p(3.0), with_p(-0.674), with_p(-2.5)};
  std::vector<Comparison*> family;
  for (Comparison& one : four) family.push_back(&one);
  correct(family);
  EXPECT_EQ(four[1].verdict, kHolds);
  EXPECT_EQ(four[3].verdict, kFails);
  EXPECT_EQ(four[0].verdict, kHolds);
  EXPECT_EQ(four[2].verdict, kOpen);
  EXPECT_NEAR(four[1].p_family, 4 * four[1].p, 1e-12);
  EXPECT_NEAR(four[3].p_family, 3 * four[3].p, 1e-12);
  EXPECT_NEAR(four[0].p_family, 2 * four[0].p, 1e-12);
  EXPECT_EQ(four[1].rank, 0);
  EXPECT_EQ(four[0].family, 4);
  // The same difference among thirty undecided ones stays open, and so do all weaker ones.
  std::vector<Comparison> many(30, with_p(0.3));
  many.push_back(with_p(2.6));
  many.push_back(with_p(4.5));
  family.clear();
  for (Comparison& one : many) family.push_back(&one);
  correct(family);
  EXPECT_EQ(many[30].verdict, kOpen);
  EXPECT_EQ(judge(Claim::more, many[30].difference), kHolds);
  EXPECT_EQ(many[31].verdict, kHolds);
  for (const Comparison& one : many) EXPECT_LE(one.p_family, 1);
}

TEST(Verdicts, HowManyVehiclesItWouldTake) {
  // 100 vehicles, standard error 0.02, difference 0.02: told with 80 % at (1.96 + 0.8416)² times as many.
  const Comparison one = comparison("", {0.02, 0.02 - 0.0391993, 0.02 + 0.0391993});
  EXPECT_EQ(one.verdict, kOpen);
  EXPECT_EQ(vehicles_needed(one, 100), 790);  // 784.9, rounded up
  Comparison ranked = one;
  ranked.family = 10;  // against 0.005: (2.807 + 0.8416)²
  EXPECT_EQ(vehicles_needed(ranked, 100), 1400);
  // The margin counts: a difference of −3 points is 2 points above its bound.
  EXPECT_EQ(vehicles_needed(comparison("", {-0.03, -0.0691993, 0.0091993}, Claim::no_less), 100), 790);
  EXPECT_FALSE(vehicles_needed(comparison("", {0, -0.04, 0.04}), 100));
  EXPECT_FALSE(vehicles_needed(comparison("", {1e-6, -0.04, 0.04}), 100));
  EXPECT_FALSE(vehicles_needed(comparison("", {0.1, -kInf, kInf}), 100));
}

TEST(Budget, FeaturesHaveTheirNamesAndSeeTheirScene) {
  std::map<std::string, double> near, far, gone;
  for (auto* features : {&near, &far, &gone}) {
    const PreparedFrame prepared =
        features == &gone ? test::made_up_frame(-20) : test::made_up_frame(features == &near ? 9 : 25);
    const HostId host{"made-up", 0};
    const Placement placement = on_roof(BoxRoofFinder().find(prepared.frame, prepared.frame.labels[0]));
    const SimulationSettings settings;
    const HostScene scene = scene_of({prepared, host, placement, settings}, test::random_mesh(3));
    *features = scene_features(scene, simulate_host(scene, settings));
  }
  const std::vector<std::string> names = {
      "camera_elevation",  "light_change",      "log_pixels",    "range",     "roof_height",  "soft_change",
      "sun_along_heading", "sun_behind_camera", "sun_elevation", "sun_share", "visible_share"};
  ASSERT_EQ(near.size(), names.size());
  for (const std::string& name : names) EXPECT_TRUE(near.contains(name)) << name;
  EXPECT_GT(near["log_pixels"], far["log_pixels"] + 1);
  EXPECT_GT(near["light_change"], 0.05);
  EXPECT_GT(near["soft_change"], 0.01);
  EXPECT_EQ(gone["log_pixels"], 0);
  EXPECT_EQ(gone["light_change"], 0);
}

}  // namespace
}  // namespace mirage::paper
