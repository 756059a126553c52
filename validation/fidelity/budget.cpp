#include "validation/fidelity/budget.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "base/intervals.h"
#include "base/random.h"
#include "base/shuffle.h"
#include "validation/fidelity/budget_rule.h"
#include "validation/fidelity/raster_rungs.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr int kFolds = 20;
/// Rungs that are no approximation of the full render.
const std::set<std::string> kNotOffered = {"sRGB shading", "+clear sky", "+car paint", "lens", "sensor"};

/// What the vehicles' results say about each rung.
struct Table {
  bool by_vehicle = false;  ///< an identity is known
  std::vector<std::string> features, rungs;
  std::vector<BudgetScene> scenes;
};

Table read_scenes(const std::vector<VehicleResult>& vehicles, BudgetOf of) {
  Table table;
  std::map<std::string, std::set<int>> tracks;
  for (const VehicleResult& vehicle : vehicles) {
    table.by_vehicle |= vehicle.track >= 0;
    tracks[vehicle.host.frame].insert(vehicle.track);  // one without a ladder links frames as well
    if (!vehicle.seen || !vehicle.seen->ladder) continue;
    const SeenResult& seen = *vehicle.seen;
    const LadderResult& ladder = *seen.ladder;
    if (of == BudgetOf::score && !seen.detected) continue;
    BudgetScene scene;
    scene.frame = vehicle.host.frame;
    scene.name = vehicle.name;
    std::vector<std::string> features, rungs;
    for (const auto& [name, value] : ladder.features) {
      features.push_back(name);
      scene.features.push_back(value);
    }
    double light_weight = 0;  // the features' renders are paid for whatever is chosen
    for (const LightRungResult& rung : ladder.light)
      if (feature_rungs().contains(rung.effect)) light_weight += rung.seconds;
    for (const LightRungResult& rung : ladder.light) {
      if (kNotOffered.contains(rung.effect)) continue;
      rungs.push_back(rung.effect);
      scene.errors.push_back(of == BudgetOf::radiance ? std::max(0.0, signed_root(rung.error.drawn))
                                                      : std::abs(rung.outcome->score - seen.cycles.score));
      scene.alone.push_back(rung.seconds);
      scene.seconds.push_back(light_weight + (feature_rungs().contains(rung.effect) ? 0 : rung.seconds));
    }
    scene.seconds_full = ladder.reference.seconds;
    scene.error_full = of == BudgetOf::radiance ? ladder.reference.noise : 0;
    if (table.scenes.empty()) table.features = features, table.rungs = rungs;
    if (features == table.features && rungs == table.rungs) table.scenes.push_back(std::move(scene));
  }
  const auto groups = linked_frames(tracks);
  for (BudgetScene& scene : table.scenes) scene.group = groups.at(scene.frame);
  return table;
}

/// The fold of each group: its own, or of many groups one of kFolds, drawn by seed.
std::map<std::string, int> folds_of(const std::vector<BudgetScene>& scenes, std::uint64_t seed) {
  std::set<std::string> all;
  for (const BudgetScene& scene : scenes) all.insert(scene.group);
  std::vector<std::string> order(all.begin(), all.end());
  RandomStream random(seed, "budget folds");
  shuffle(order, random);
  std::map<std::string, int> folds;
  for (std::size_t i = 0; i < order.size(); ++i) folds[order[i]] = static_cast<int>(i) % kFolds;
  return folds;
}

/// The cheapest rung that keeps the budget for `confidence` of the scenes (each group counts alike); −1:
/// none.
int fixed_rung(const std::vector<BudgetScene>& scenes, const BudgetSettings& settings) {
  int best = -1;
  double least = 0;
  std::map<std::string, int> members;
  for (const BudgetScene& scene : scenes) ++members[scene.group];
  for (std::size_t r = 0; r < scenes.front().errors.size(); ++r) {
    double within = 0, seconds = 0, full = 0;
    for (const BudgetScene& scene : scenes) {
      within += (scene.errors[r] <= settings.budget) / static_cast<double>(members[scene.group]) /
                static_cast<double>(members.size());
      seconds += scene.alone[r];
      full += scene.seconds_full;
    }
    if (within >= settings.confidence - 1e-12 && seconds < full && (best < 0 || seconds < least))
      best = static_cast<int>(r), least = seconds;
  }
  return best;
}

/// Cheapest rung that does keep the budget: what nothing can beat.
int oracle(const BudgetScene& scene, double budget) {
  int best = -1;
  for (std::size_t r = 0; r < scene.errors.size(); ++r)
    if (scene.errors[r] <= budget && scene.alone[r] < scene.seconds_full &&
        (best < 0 || scene.alone[r] < scene.alone[static_cast<std::size_t>(best)]))
      best = static_cast<int>(r);
  return best;
}

/// One way of choosing, over scenes.
struct Tally {
  ClusteredShare within;  ///< by group
  double seconds = 0;
  std::map<std::string, int> chosen;
  int vehicles = 0;

  BudgetWay way() const { return {within.interval(), seconds / std::max(1, vehicles), chosen}; }
  /// Share of the other's time that it saves.
  double saved_of(const Tally& other) const { return other.seconds > 0 ? 1 - seconds / other.seconds : 0; }
};

/// Counts that the way takes this rung (−1: the reference) for the scene. `costs`: of the rungs; `own_cost`:
/// beside the reference's.
BudgetChoice take(Tally& tally, const Table& table, const BudgetScene& scene, int rung,
                  const std::vector<double>& costs, double own_cost, double budget) {
  const auto r = static_cast<std::size_t>(std::max(0, rung));
  BudgetChoice choice;
  choice.name = scene.name, choice.frame = scene.frame, choice.group = scene.group;
  choice.chosen = rung < 0 ? "reference" : table.rungs[r];
  choice.error = rung < 0 ? scene.error_full : scene.errors[r];
  choice.within = choice.error <= budget;
  choice.seconds = rung < 0 ? own_cost + scene.seconds_full : costs[r];
  ++tally.vehicles;
  tally.within.add(scene.group, choice.within);
  tally.seconds += choice.seconds;
  ++tally.chosen[choice.chosen];
  return choice;
}

BudgetTest test_rule(const Table& table, const std::map<std::string, int>& folds, int count,
                     const BudgetSettings& settings) {
  BudgetTest test{BudgetRule(table.scenes, settings.budget, settings.confidence)};
  Tally ruled, fixed, best;
  std::set<std::string> frames;
  for (int fold = 0; fold < count; ++fold) {
    std::vector<BudgetScene> others;
    for (const BudgetScene& scene : table.scenes)
      if (folds.at(scene.group) != fold) others.push_back(scene);
    const BudgetRule rule(others, settings.budget, settings.confidence);
    const int always = fixed_rung(others, settings);
    for (const BudgetScene& scene : table.scenes) {
      if (folds.at(scene.group) != fold) continue;
      frames.insert(scene.frame);
      // One rung for all needs no features.
      const double features_cost = *std::min_element(scene.seconds.begin(), scene.seconds.end());
      BudgetChoice choice = take(ruled, table, scene, rule.choose(scene.features),
                                 rule.always() ? scene.alone : scene.seconds, features_cost, settings.budget);
      choice.fold = fold;
      choice.seconds_fixed = take(fixed, table, scene, always, scene.alone, 0, settings.budget).seconds;
      take(best, table, scene, oracle(scene, settings.budget), scene.alone, 0, settings.budget);
      test.scenes.push_back(std::move(choice));
    }
  }
  test.frames = static_cast<int>(frames.size());
  test.vehicles = ruled.vehicles;
  test.ruled = ruled.way(), test.fixed = fixed.way(), test.oracle = best.way();
  test.kept = test.ruled.within.value >= settings.confidence;
  test.saved = ruled.saved_of(fixed), test.saved_by_oracle = best.saved_of(fixed);
  return test;
}

json way_figures(const BudgetWay& way) {
  return {{"within", to_json(way.within)}, {"seconds", way.seconds}, {"chosen", way.chosen}};
}

json test_figures(const BudgetTest& test) {
  json out = way_figures(test.ruled);
  out.update({{"frames", test.frames},
              {"vehicles", test.vehicles},
              {"kept", test.kept},
              {"saved", test.saved},
              {"fixed", way_figures(test.fixed)},
              {"oracle", way_figures(test.oracle)}});
  out["oracle"]["saved"] = test.saved_by_oracle;
  return out;
}

json choice_figures(const BudgetChoice& choice) {
  return {{"name", choice.name},     {"frame", choice.frame},     {"group", choice.group},
          {"fold", choice.fold},     {"chosen", choice.chosen},   {"error", choice.error},
          {"within", choice.within}, {"seconds", choice.seconds}, {"seconds_fixed", choice.seconds_fixed}};
}

}  // namespace

BudgetReport choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings) {
  const Table table = read_scenes(vehicles, settings.of);
  const std::map<std::string, int> folds = folds_of(table.scenes, settings.seed);
  BudgetReport report;
  report.settings = settings;
  report.features = table.features, report.rungs = table.rungs;
  report.by_vehicle = table.by_vehicle;
  report.groups = static_cast<int>(folds.size());
  report.folds = std::min(report.groups, kFolds);
  if (report.folds >= 2) report.test = test_rule(table, folds, report.folds, settings);
  return report;
}

json to_json(const BudgetReport& report) {
  json out = {
      {"budget", report.settings.budget},
      {"of", to_word(report.settings.of)},
      {"confidence", report.settings.confidence},
      {"features", report.features},
      {"rule",
       "ridge regression of each rung's log error on standardised features; the cheapest rung whose "
       "prediction plus lambda times its spread is within the budget, else the reference, or one rung for "
       "all where that is cheaper; both by conformal risk control over the groups that it is not tested on"},
      {"groups",
       {{"by", report.by_vehicle ? "vehicle" : "frame"}, {"count", report.groups}, {"folds", report.folds}}}};
  if (!report.test) {
    out["problem"] = "too few frames to calibrate on some and test on others";
    return out;
  }
  out.update(to_json(report.test->rule));
  for (std::size_t r = 0; r < report.rungs.size(); ++r) out["rungs"][r]["name"] = report.rungs[r];
  out["test"] = test_figures(*report.test);
  auto& scenes = out["scenes"] = json::array();
  for (const BudgetChoice& choice : report.test->scenes) scenes.push_back(choice_figures(choice));
  return out;
}

}  // namespace mirage
