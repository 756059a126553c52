// The budget of a validation: its rule (budget_rule.h) tried on every scene, each time without the scene's
// group.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/intervals.h"
#include "validation/fidelity/budget_rule.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// Of what an error is a share: the object's mean radiance under full Cycles, or the detector's score (which
/// is in [0, 1] itself).
enum class BudgetOf { radiance, score };
constexpr auto words_of(BudgetOf) {
  return std::to_array<const char*>({"radiance", "score"});
}

struct BudgetSettings {
  double budget = 0.05;
  BudgetOf of = BudgetOf::radiance;
  std::uint64_t seed = 0;  ///< of the folds
  double confidence = 0.9;
};

/// A way of choosing rungs, over scenes.
struct BudgetWay {
  Interval within;                    ///< share of the scenes within the budget, drawn over groups
  double seconds = 0;                 ///< mean of a scene
  std::map<std::string, int> chosen;  ///< how often each rung, "reference" among them
};

/// What the rule that was fitted without a scene's group takes for it.
struct BudgetChoice {
  std::string name, frame, group;
  int fold = 0;
  std::string chosen;
  double error = 0;
  bool within = false;
  double seconds = 0, seconds_fixed = 0;  ///< of the rule, and of BudgetTest::fixed
};

struct BudgetTest {
  BudgetRule rule;  ///< from all scenes, for others to use
  int frames = 0, vehicles = 0;
  BudgetWay ruled = {};
  /// The cheapest single rung that keeps the budget for the asked share of the same calibration scenes, else
  /// the reference.
  BudgetWay fixed = {};
  BudgetWay oracle = {};                  ///< of who knew each error beforehand
  bool kept = false;                      ///< whether ruled.within reaches the confidence
  double saved = 0, saved_by_oracle = 0;  ///< shares of fixed's time
  std::vector<BudgetChoice> scenes = {};  ///< by fold
};

struct BudgetReport {
  BudgetSettings settings;
  bool by_vehicle = false;  ///< whether an identity is known that links frames to groups
  int groups = 0, folds = 0;
  std::vector<std::string> features, rungs;  ///< in the rule's order, which is the ladder's
  std::optional<BudgetTest> test;            ///< none with fewer than two folds
};

/// Tests the rule on every scene, each time fitted and calibrated on the other groups (leave one group out;
/// of more than 20 groups, drawn into 20 folds by seed, leave one fold out). Of vehicles without ladder or
/// features nothing is used; for the score, only those found without the adversary.
BudgetReport choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings);

/// result.json's "budget": {budget, of, confidence, features, rule (in words), groups: {by: "vehicle" or
/// "frame", count, folds}}; without a test `problem`, else also the fields of to_json(BudgetRule), its rungs
/// with their name, scenes, and test: ruled's fields, and frames, vehicles, kept, saved, fixed, oracle (with
/// its own saved).
nlohmann::json to_json(const BudgetReport& report);

}  // namespace mirage
