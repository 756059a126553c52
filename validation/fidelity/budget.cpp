#include "validation/fidelity/budget.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/json_fields.h"
#include "base/random.h"
#include "base/sizes.h"
#include "validation/fidelity/ladders.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr double kRidge = 1;
constexpr double kFloor = 1e-4;  // error at which its logarithm levels off
constexpr double kMaxLambda = 8, kLambdaStep = 0.05;

double logarithm(double error) {
  return std::log(error + kFloor);
}

/// `groups`: places of each one's scenes. Whether the groups' shares of scenes beyond the budget bound the
/// share of a new group.
template <class Groups, class IsBeyond>
bool is_backed(const Groups& groups, double confidence, const IsBeyond& is_beyond) {
  double risk = 0;
  for (const auto& [group, members] : groups)
    risk += static_cast<double>(std::count_if(members.begin(), members.end(), is_beyond)) /
            static_cast<double>(members.size());
  return (risk + 1) / (static_cast<double>(groups.size()) + 1) <= 1 - confidence + 1e-12;
}

/// The scenes of other groups; all without a group.
std::vector<const BudgetScene*> without(const std::vector<BudgetScene>& scenes, const std::string* group) {
  std::vector<const BudgetScene*> list;
  for (const BudgetScene& scene : scenes)
    if (!group || scene.group != *group) list.push_back(&scene);
  return list;
}

constexpr int kFolds = 20;
/// Rungs that are no approximation of the full render.
const std::set<std::string> kNotOffered = {"sRGB shading", "+clear sky", "+car paint", "lens", "sensor"};

/// The scenes of the vehicles' results, with each rung. Enters into the report which features and rungs they
/// have, and whether an identity is known.
std::vector<BudgetScene> read_scenes(const std::vector<VehicleResult>& vehicles, BudgetReport& report) {
  const BudgetOf of = report.settings.of;
  std::vector<BudgetScene> scenes;
  std::map<std::string, std::set<int>> tracks;
  for (const VehicleResult& vehicle : vehicles) {
    report.by_vehicle |= vehicle.track >= 0;
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
      if (kFeatureRungs.contains(rung.effect)) light_weight += rung.seconds;
    for (const LightRungResult& rung : ladder.light) {
      if (kNotOffered.contains(rung.effect)) continue;
      rungs.push_back(rung.effect);
      scene.errors.push_back(of == BudgetOf::radiance ? std::max(0.0, signed_root(rung.error.drawn))
                                                      : std::abs(rung.outcome->score - seen.cycles.score));
      scene.alone.push_back(rung.seconds);
      scene.seconds.push_back(light_weight + (kFeatureRungs.contains(rung.effect) ? 0 : rung.seconds));
    }
    scene.seconds_full = ladder.reference.seconds;
    scene.error_full = of == BudgetOf::radiance ? ladder.reference.noise : 0;
    if (scenes.empty()) report.features = features, report.rungs = rungs;
    if (features == report.features && rungs == report.rungs) scenes.push_back(std::move(scene));
  }
  const auto groups = linked_frames(tracks);
  for (BudgetScene& scene : scenes) scene.group = groups.at(scene.frame);
  return scenes;
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

/// The cheapest rung that keeps the budget for this scene: the optimum.
int oracle(const BudgetScene& scene, double budget) {
  int best = -1;
  for (std::size_t r = 0; r < scene.errors.size(); ++r)
    if (scene.errors[r] <= budget && scene.alone[r] < scene.seconds_full &&
        (best < 0 || scene.alone[r] < scene.alone[as_size(best)]))
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
  /// The share of the other way's time that this one saves.
  double saved_of(const Tally& other) const { return other.seconds > 0 ? 1 - seconds / other.seconds : 0; }
};

/// Counts that the way takes this rung (−1: the reference) for the scene. `costs`: of the rungs; `own_cost`:
/// beside the reference's.
BudgetChoice take(Tally& tally, const BudgetReport& report, const BudgetScene& scene, int rung,
                  const std::vector<double>& costs, double own_cost) {
  const auto r = as_size(std::max(0, rung));
  BudgetChoice choice;
  choice.name = scene.name, choice.frame = scene.frame, choice.group = scene.group;
  choice.chosen = rung < 0 ? "reference" : report.rungs[r];
  choice.error = rung < 0 ? scene.error_full : scene.errors[r];
  choice.within = choice.error <= report.settings.budget;
  choice.seconds = rung < 0 ? own_cost + scene.seconds_full : costs[r];
  ++tally.vehicles;
  tally.within.add(scene.group, choice.within);
  tally.seconds += choice.seconds;
  ++tally.chosen[choice.chosen];
  return choice;
}

BudgetTest test_rule(const BudgetReport& report, const std::vector<BudgetScene>& scenes,
                     const std::map<std::string, int>& folds) {
  const BudgetSettings& settings = report.settings;
  BudgetTest test{BudgetRule(scenes, settings.budget, settings.confidence)};
  Tally ruled, fixed, best;
  std::set<std::string> frames;
  for (int fold = 0; fold < report.folds; ++fold) {
    std::vector<BudgetScene> others;
    for (const BudgetScene& scene : scenes)
      if (folds.at(scene.group) != fold) others.push_back(scene);
    const BudgetRule rule(others, settings.budget, settings.confidence);
    const int always = fixed_rung(others, settings);
    for (const BudgetScene& scene : scenes) {
      if (folds.at(scene.group) != fold) continue;
      frames.insert(scene.frame);
      // One rung for all needs no features.
      const double features_cost = *std::min_element(scene.seconds.begin(), scene.seconds.end());
      BudgetChoice choice = take(ruled, report, scene, rule.choose(scene.features),
                                 rule.always() ? scene.alone : scene.seconds, features_cost);
      choice.fold = fold;
      choice.seconds_fixed = take(fixed, report, scene, always, scene.alone, 0).seconds;
      take(best, report, scene, oracle(scene, settings.budget), scene.alone, 0);
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

}  // namespace

BudgetRule::BudgetRule(const std::vector<BudgetScene>& calibration, double budget, double confidence)
    : budget_(budget), lambda_(std::numeric_limits<double>::infinity()) {
  Groups groups;
  for (std::size_t i = 0; i < calibration.size(); ++i) groups[calibration[i].group].push_back(i);
  standardise(calibration);
  const Predictions left_out = left_out_predictions(calibration, groups);
  fit_rungs(calibration, left_out);
  calibrate(calibration, groups, left_out, confidence);
  try_single_rung(calibration, groups, left_out, confidence);
}

void BudgetRule::standardise(const std::vector<BudgetScene>& calibration) {
  const std::size_t features = calibration.at(0).features.size();
  const auto n = static_cast<double>(calibration.size());
  mean_.assign(features, 0);
  scale_.assign(features, 0);
  for (const BudgetScene& scene : calibration)
    for (std::size_t k = 0; k < features; ++k) mean_[k] += scene.features[k] / n;
  for (const BudgetScene& scene : calibration)
    for (std::size_t k = 0; k < features; ++k)
      scale_[k] += (scene.features[k] - mean_[k]) * (scene.features[k] - mean_[k]) / n;
  for (double& scale : scale_) scale = scale > 1e-18 ? std::sqrt(scale) : 1;  // a constant one says nothing
}

BudgetRule::Predictions BudgetRule::left_out_predictions(const std::vector<BudgetScene>& calibration,
                                                         const Groups& groups) const {
  const std::size_t rungs = calibration.at(0).errors.size();
  Predictions left_out(calibration.size(), std::vector<double>(rungs));
  for (const auto& [group, members] : groups) {
    const auto others = without(calibration, &group);
    for (std::size_t r = 0; r < rungs; ++r) {
      const Rung fitted = fit(others, r);
      for (const std::size_t i : members) left_out[i][r] = predict(fitted, calibration[i].features);
    }
  }
  return left_out;
}

void BudgetRule::fit_rungs(const std::vector<BudgetScene>& calibration, const Predictions& left_out) {
  const auto all = without(calibration, nullptr);
  const auto n = static_cast<double>(calibration.size());
  for (std::size_t r = 0; r < calibration.at(0).errors.size(); ++r) {
    Rung rung = fit(all, r);
    double sum = 0;
    for (std::size_t i = 0; i < calibration.size(); ++i) {
      const double residual = logarithm(calibration[i].errors[r]) - left_out[i][r];
      sum += residual * residual / n;
      rung.seconds += calibration[i].seconds[r] / n;
    }
    rung.spread = std::sqrt(sum);
    rungs_.push_back(std::move(rung));
  }
  by_cost_.resize(rungs_.size());
  std::iota(by_cost_.begin(), by_cost_.end(), std::size_t{0});
  std::stable_sort(by_cost_.begin(), by_cost_.end(),
                   [&](std::size_t a, std::size_t b) { return rungs_[a].seconds < rungs_[b].seconds; });
}

/// From the largest λ down, as long as the bound holds.
void BudgetRule::calibrate(const std::vector<BudgetScene>& calibration, const Groups& groups,
                           const Predictions& left_out, double confidence) {
  for (int step = static_cast<int>(std::lround(kMaxLambda / kLambdaStep)); step >= 0; --step) {
    const double lambda = step * kLambdaStep;
    const auto is_beyond = [&](std::size_t i) {
      const int rung = choose(left_out[i], lambda);
      return rung >= 0 && calibration[i].errors[as_size(rung)] > budget_;
    };
    if (!is_backed(groups, confidence, is_beyond)) break;
    lambda_ = lambda;
  }
}

void BudgetRule::try_single_rung(const std::vector<BudgetScene>& calibration, const Groups& groups,
                                 const Predictions& left_out, double confidence) {
  const auto n = static_cast<double>(calibration.size());
  double least = 0;  // the rule's cost
  for (std::size_t i = 0; i < calibration.size(); ++i) {
    const BudgetScene& scene = calibration[i];
    const int rung = choose(left_out[i], lambda_);
    least += rung >= 0 ? scene.seconds[as_size(rung)]
                       : scene.seconds_full + *std::min_element(scene.seconds.begin(), scene.seconds.end());
  }
  least /= n;
  for (std::size_t r = 0; r < rungs_.size(); ++r) {
    double seconds = 0;
    for (const BudgetScene& scene : calibration) seconds += scene.alone[r] / n;
    const auto is_beyond = [&](std::size_t i) { return calibration[i].errors[r] > budget_; };
    if (!(seconds < least) || !is_backed(groups, confidence, is_beyond)) continue;
    least = seconds;
    always_ = static_cast<int>(r);
  }
}

std::vector<double> BudgetRule::standardised(const std::vector<double>& features) const {
  std::vector<double> out(features.size());
  for (std::size_t k = 0; k < features.size(); ++k) out[k] = (features[k] - mean_[k]) / scale_[k];
  return out;
}

BudgetRule::Rung BudgetRule::fit(const std::vector<const BudgetScene*>& scenes, std::size_t rung) const {
  const auto size = static_cast<Eigen::Index>(mean_.size()) + 1;
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(size);
  for (const BudgetScene* scene : scenes) {
    const std::vector<double> z = standardised(scene->features);
    Eigen::VectorXd x(size);
    x << 1, Eigen::Map<const Eigen::VectorXd>(z.data(), size - 1);
    normal += x * x.transpose();
    right += logarithm(scene->errors[rung]) * x;
  }
  normal.diagonal().tail(size - 1).array() += kRidge;
  if (scenes.empty()) normal(0, 0) = 1;  // nothing left when the only group is left out: predicts log 1
  const Eigen::VectorXd solved = normal.ldlt().solve(right);
  Rung result;
  result.coefficients.assign(solved.data(), solved.data() + size);
  return result;
}

double BudgetRule::predict(const Rung& rung, const std::vector<double>& features) const {
  const std::vector<double> z = standardised(features);
  return std::inner_product(z.begin(), z.end(), rung.coefficients.begin() + 1, rung.coefficients[0]);
}

int BudgetRule::choose(const std::vector<double>& predictions, double lambda) const {
  if (!std::isfinite(lambda)) return -1;
  for (const std::size_t r : by_cost_)
    if (predictions[r] + lambda * rungs_[r].spread <= logarithm(budget_)) return static_cast<int>(r);
  return -1;
}

int BudgetRule::choose(const std::vector<double>& features) const {
  if (always_) return *always_;
  std::vector<double> predictions;
  for (const Rung& rung : rungs_) predictions.push_back(predict(rung, features));
  return choose(predictions, lambda_);
}

json to_json(const BudgetRule& rule) {
  auto rungs = list_json(rule.rungs_, [](const BudgetRule::Rung& rung) -> json {
    return {{"seconds", rung.seconds}, {"spread", rung.spread}, {"coefficients", rung.coefficients}};
  });
  return {{"lambda", std::isfinite(rule.lambda_) ? json(rule.lambda_) : json()},
          {"always", rule.always_ ? json(*rule.always_) : json()},
          {"feature_mean", rule.mean_},
          {"feature_scale", rule.scale_},
          {"rungs", std::move(rungs)}};
}

std::map<std::string, std::string> linked_frames(const std::map<std::string, std::set<int>>& tracks) {
  std::map<std::string, std::string> group;
  for (const auto& [frame, seen] : tracks) group[frame] = frame;
  std::map<int, std::string> first;  // a frame that shows the vehicle
  for (const auto& [frame, seen] : tracks)
    for (const int track : seen) {
      if (track < 0) continue;
      const auto [other, added] = first.try_emplace(track, frame);
      const std::string a = group.at(frame), b = group.at(other->second);
      for (auto& [name, of] : group)
        if (of == a || of == b) of = std::min(a, b);
    }
  return group;
}

BudgetReport choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings) {
  BudgetReport report;
  report.settings = settings;
  const std::vector<BudgetScene> scenes = read_scenes(vehicles, report);
  const std::map<std::string, int> folds = folds_of(scenes, settings.seed);
  report.groups = static_cast<int>(folds.size());
  report.folds = std::min(report.groups, kFolds);
  if (report.folds >= 2) report.test = test_rule(report, scenes, folds);
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
  out["test"] = fields_json(*report.test);
  out["test"]["oracle"]["saved"] = report.test->saved_by_oracle;
  out["scenes"] = list_json(report.test->scenes, fields_json<BudgetChoice>);
  return out;
}

}  // namespace mirage
