// Model only what a scene requires: which rung of the ladder is the cheapest that keeps the error within a
// budget, told from features that cost milliseconds (scene_features.h).
//
// Rule. For each rung r, log(error_r + 1e-4) is regressed on the features by ridge regression (λ = 1 on
// standardised features; the intercept is free), fitted on the calibration scenes; s_r is the root mean
// square of its residuals with each group left out. The cheapest rung with
//     prediction_r + λ s_r ≤ log(budget + 1e-4)
// is chosen, else the reference: the full render with four times the samples (light_ladder.h). λ is
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
// (training/track_2) are of one drive, and are one group, through any number of steps; a frame without such
// a link is a group of its own, although it may be of a drive that others are of.
//
// Errors are those of the pictures as they would be used: their own noise counts, that of what they are
// measured against does not (`drawn` of unbiased_error.h).
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/json_fields.h"

namespace mirage {

/// Rungs and features that a written rule may have.
inline constexpr std::size_t kMostRungs = 256;

/// A vehicle with what each rung costs and how far it is off.
struct BudgetScene {
  std::string frame, name;
  std::string group;                        ///< what is left out together (the file's head)
  std::vector<double> features, errors;     ///< errors by rung
  std::vector<double> seconds, alone;       ///< by rung, with and without what the features cost
  double seconds_full = 0, error_full = 0;  ///< of the reference; its error is its own noise
};

/// The groups of frames, by the vehicles seen in each (identities; negative ones are unknown and link
/// nothing). A group's name is that of its first frame.
std::map<std::string, std::string> linked_frames(const std::map<std::string, std::set<int>>& tracks);

class BudgetRule {
 public:
  /// Fits and calibrates. All scenes have the same features and rungs; there is at least one.
  BudgetRule(const std::vector<BudgetScene>& calibration, double budget, double confidence);
  /// One that was written by to_json, of so many features and rungs. InputError naming file and field.
  BudgetRule(const JsonFields& written, double budget, std::size_t features, std::size_t rungs);
  /// Index of the rung; −1: the reference.
  int choose(const std::vector<double>& features) const;
  /// The rung that is taken for all, whatever their features.
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
  void order_by_cost();
  void standardise(const std::vector<BudgetScene>& calibration);
  Predictions left_out_predictions(const std::vector<BudgetScene>& calibration, const Groups& groups) const;
  void fit_rungs(const std::vector<BudgetScene>& calibration, const Predictions& left_out);
  void calibrate(const std::vector<BudgetScene>& calibration, const Groups& groups,
                 const Predictions& left_out, double confidence);
  void try_one_for_all(const std::vector<BudgetScene>& calibration, const Groups& groups,
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

}  // namespace mirage
