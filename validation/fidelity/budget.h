// Model only what a scene requires: which rung of the ladder is the cheapest that keeps the error within a
// budget, told from features that cost milliseconds.
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
// and hence the test on groups that had no part in any of this.
//
// Groups. Scenes of one drive are alike, so a rule must be judged on drives that it has not seen. KITTI's
// object folders do not say which drive a frame is of; frames that show one and the same vehicle
// (training/track_2) are of one drive, and are one group, through any number of steps; a frame without such
// a link is a group of its own, although it may be of a drive that others are of.
//
// Errors are those of the pictures as they would be used: their own noise counts, that of what they are
// measured against does not (`drawn` of unbiased_error.h).
#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "simulation/insertion.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

struct HostScene;

/// Of what an error is a share: the object's mean radiance under full Cycles, or the detector's score (which
/// is in [0, 1] itself).
enum class BudgetOf { radiance, score };
/// InputError for other words than "radiance" and "score".
BudgetOf parse_budget_of(const std::string& word);

struct BudgetSettings {
  double budget = 0.05;
  BudgetOf of = BudgetOf::radiance;
  std::uint64_t seed = 0;  ///< of the folds
  double confidence = 0.9;
};

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
  /// Index of the rung; −1: the reference.
  int choose(const std::vector<double>& features) const;
  /// Its numbers: {lambda, feature_mean, feature_scale, rungs: [{seconds, spread, coefficients}]}.
  nlohmann::json numbers() const;

 private:
  struct Rung {
    std::vector<double> coefficients;  ///< intercept, then of the standardised features
    double spread = 0, seconds = 0;
  };
  std::vector<double> standardised(const std::vector<double>& features) const;
  Rung fit(const std::vector<const BudgetScene*>& scenes, std::size_t rung) const;
  double predict(const Rung& rung, const std::vector<double>& features) const;
  int choose(const std::vector<double>& predictions, double lambda) const;

  double budget_ = 0, lambda_ = 0;  ///< lambda_: infinite where no rung may be trusted
  std::vector<double> mean_, scale_;
  std::vector<Rung> rungs_;
  std::vector<std::size_t> by_cost_;
};

/// Features of a scene: the sun's elevation (rad), its azimuth against the camera (cosine; 1: it stands
/// behind the camera) and against the vehicle's heading, its share of the light, the roof's height over the
/// road (m), the vehicle's range (m), the camera's elevation seen from the roof (rad), log of the object's
/// pixels, its visible share. validate_vehicle adds what two light-weight renders tell: soft_change and
/// light_change, the relative change from hard edges to soft ones and from the plain light model to the one
/// with visibility.
std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated);

/// Tests the rule on every scene, each time fitted and calibrated on the other groups (leave one group out;
/// of more than 20 groups, drawn into 20 folds by seed, leave one fold out): result.json's "budget".
///   test: {frames, vehicles, within, kept, seconds, saved, chosen, fixed, oracle}: over all scenes; within
///   with
///     its interval over groups, kept: whether it reaches the confidence.
///   test.fixed: {within, seconds, chosen} of the cheapest single rung that keeps the budget for the asked
///   share
///     of the same calibration scenes, else the reference: what `saved` is against.
///   test.oracle: {seconds, saved} of who knew each error beforehand.
///   groups: {by: "vehicle" or "frame", count, folds}; scenes: each with its fold and what was chosen;
///   lambda, feature_mean, feature_scale, rungs: the rule from all scenes, for others to use.
/// Of vehicles without ladder or features nothing is used; for the score, only those found without the
/// adversary. The rungs' order is the ladder's.
nlohmann::json choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings);

}  // namespace mirage
