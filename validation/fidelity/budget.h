// Render only the effects that a scene requires: choose the cheapest rung of the ladder that keeps the error
// within a budget, by features that cost milliseconds (ladders.h).
//
// Rule. For each rung r, log(error_r + 1e-4) is regressed on the features by ridge regression (λ = 1 on
// standardised features; the intercept is free), fitted on the calibration scenes; s_r is the root mean
// square of its residuals with each group left out. The cheapest rung with
//     prediction_r + λ s_r ≤ log(budget + 1e-4)
// is chosen, else the reference: the full render with four times the samples (ladders.h). λ is
// calibrated on the left-out predictions by conformal risk control (Angelopoulos, Bates, Fisch, Lei,
// Schuster, ICLR 2024): the smallest λ from which on
//     (Σ over groups of the share of its vehicles beyond the budget + 1) / (groups + 1) ≤ 1 − confidence.
// With fewer than 1/(1 − confidence) − 1 groups no λ does, and everything is rendered in full. The risk bound
// is for monotone losses; here an error may rise with λ where a dearer rung is worse, hence "from which on",
// and hence the test on groups that had no part in any of this (budget.h).
//
// One for all. Where a single rung has that bound by itself (its risk is that of the scenes on which it is
// beyond the budget) and costs less than what the rule takes on average, features included, it is taken for
// every scene: nothing has to be told apart then, and features are not worth their time.
//
// Groups. Scenes of one drive are alike, so a rule must be judged on drives that it has not seen. KITTI's
// object folders do not say which drive a frame is of; frames that show one and the same vehicle
// (training/track_2) are of one drive, and are one group, through any number of steps; a frame without a link
// is its own group, although its drive may have other frames.
//
// Errors are those of the pictures as used: their own noise counts, the reference's does not (`drawn` of
// unbiased_error.h).
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/intervals.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// A vehicle with the cost and the error of each rung.
struct BudgetScene {
  std::string frame, name;
  std::string group;                        ///< scenes that are left out together (see the file's head)
  std::vector<double> features, errors;     ///< errors by rung
  std::vector<double> seconds, alone;       ///< by rung, with and without the features' cost
  double seconds_full = 0, error_full = 0;  ///< of the reference; its error is its own noise
};

/// The groups of frames, by the vehicles seen in each (identities; negative ones are unknown and link
/// nothing). A group's name is that of its first frame.
std::map<std::string, std::string> linked_frames(const std::map<std::string, std::set<int>>& tracks);

class BudgetRule {
 public:
  /// Fits and calibrates. All scenes have the same features and rungs; there is at least one.
  BudgetRule(const std::vector<BudgetScene>& calibration, double budget, double confidence);
  /// Index of the rung; −1: the reference.
  int choose(const std::vector<double>& features) const;
  /// The rung that is taken for all scenes, whatever their features.
  std::optional<int> always() const { return always_; }
  /// {lambda (null: infinite), always (null: none), feature_mean, feature_scale, rungs: [{seconds, spread,
  /// coefficients}]}.
  friend nlohmann::json to_json(const BudgetRule& rule);

 private:
  struct Rung {
    std::vector<double> coefficients;  ///< intercept, then of the standardised features
    double spread = 0, seconds = 0;
  };
  using Groups = std::map<std::string, std::vector<std::size_t>>;  ///< places of a group's scenes
  using Predictions = std::vector<std::vector<double>>;            ///< by scene and rung
  void standardise(const std::vector<BudgetScene>& calibration);
  Predictions left_out_predictions(const std::vector<BudgetScene>& calibration, const Groups& groups) const;
  void fit_rungs(const std::vector<BudgetScene>& calibration, const Predictions& left_out);
  void calibrate(const std::vector<BudgetScene>& calibration, const Groups& groups,
                 const Predictions& left_out, double confidence);
  void try_single_rung(const std::vector<BudgetScene>& calibration, const Groups& groups,
                       const Predictions& left_out, double confidence);
  std::vector<double> standardised(const std::vector<double>& features) const;
  /// Coefficients alone.
  Rung fit(const std::vector<const BudgetScene*>& scenes, std::size_t rung) const;
  double predict(const Rung& rung, const std::vector<double>& features) const;
  int choose(const std::vector<double>& predictions, double lambda) const;

  double budget_ = 0, lambda_ = 0;
  std::vector<double> mean_, scale_;
  std::vector<Rung> rungs_;
  std::vector<std::size_t> by_cost_;
  std::optional<int> always_;
};

// The budget of a validation: its rule (budget.h) tried on every scene, each time without the scene's group.

/// The quantity that an error is a share of: the object's mean radiance under full Cycles, or the detector's
/// score (which is in [0, 1] itself).
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
  std::map<std::string, int> chosen;  ///< how often each rung was chosen, "reference" included
};
template <class Visitor, FieldsOf<BudgetWay> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "within", s.within, "seconds", s.seconds, "chosen", s.chosen);
}

/// The choice for a scene by the rule that was fitted without its group.
struct BudgetChoice {
  std::string name, frame, group;
  int fold = 0;
  std::string chosen;
  double error = 0;
  bool within = false;
  double seconds = 0, seconds_fixed = 0;  ///< of the rule, and of BudgetTest::fixed
};
template <class Visitor, FieldsOf<BudgetChoice> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "name", .plain = true}, s.name);
  visit({.name = "frame", .plain = true}, s.frame);
  visit({.name = "group", .plain = true}, s.group);
  visit_named(visit, "fold", s.fold, "chosen", s.chosen, "error", s.error, "within", s.within, "seconds",
              s.seconds, "seconds_fixed", s.seconds_fixed);
}

struct BudgetTest {
  BudgetRule rule;  ///< from all scenes, for others to use
  int frames = 0, vehicles = 0;
  BudgetWay ruled = {};
  /// The cheapest single rung that keeps the budget for the asked share of the same calibration scenes, else
  /// the reference.
  BudgetWay fixed = {};
  BudgetWay oracle = {};                  ///< of an oracle that knows each error beforehand
  bool kept = false;                      ///< whether ruled.within reaches the confidence
  double saved = 0, saved_by_oracle = 0;  ///< shares of fixed's time
  std::vector<BudgetChoice> scenes = {};  ///< by fold
};
/// Without the rule, `scenes` and `saved_by_oracle`.
template <class Visitor, FieldsOf<BudgetTest> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.ruled);
  visit_named(visit, "frames", s.frames, "vehicles", s.vehicles, "kept", s.kept, "saved", s.saved, "fixed",
              s.fixed, "oracle", s.oracle);
}

struct BudgetReport {
  BudgetSettings settings;
  bool by_vehicle = false;  ///< whether an identity is known that links frames to groups
  int groups = 0, folds = 0;
  std::vector<std::string> features, rungs;  ///< in the rule's order, which is the ladder's
  std::optional<BudgetTest> test;            ///< none with fewer than two folds
};

/// Tests the rule on every scene, each time fitted and calibrated on the other groups (leave one group out;
/// of more than 20 groups, drawn into 20 folds by seed, leave one fold out). Vehicles without ladder or
/// features are left out; for the score, also vehicles not found without the adversary.
BudgetReport choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings);

/// result.json's "budget": {budget, of, confidence, features, rule (in words), groups: {by: "vehicle" or
/// "frame", count, folds}}; without a test `problem`, else also the fields of to_json(BudgetRule), its rungs
/// with their name, scenes, and test: ruled's fields, and frames, vehicles, kept, saved, fixed, oracle (with
/// its own saved).
nlohmann::json to_json(const BudgetReport& report);

}  // namespace mirage
