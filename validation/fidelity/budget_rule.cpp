#include "validation/fidelity/budget_rule.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace mirage {
namespace {

using nlohmann::json;

constexpr double kRidge = 1;
constexpr double kFloor = 1e-4;  // error at which its logarithm levels off
constexpr double kLargestLambda = 8, kLambdaStep = 0.05;

double logarithm(double error) {
  return std::log(error + kFloor);
}

/// `groups`: places of each one's scenes. Whether the groups' shares of scenes that are beyond the budget
/// bound that of another group.
template <class Groups, class IsBeyond>
bool is_backed(const Groups& groups, double confidence, const IsBeyond& is_beyond) {
  double risk = 0;
  for (const auto& [group, members] : groups)
    risk += static_cast<double>(std::count_if(members.begin(), members.end(), is_beyond)) /
            static_cast<double>(members.size());
  return (risk + 1) / (static_cast<double>(groups.size()) + 1) <= 1 - confidence + 1e-12;
}

/// Those of other groups.
std::vector<const BudgetScene*> without(const std::vector<BudgetScene>& scenes, const std::string* group) {
  std::vector<const BudgetScene*> list;
  for (const BudgetScene& scene : scenes)
    if (!group || scene.group != *group) list.push_back(&scene);
  return list;
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
  try_one_for_all(calibration, groups, left_out, confidence);
}

BudgetRule::BudgetRule(const JsonFields& written, double budget, std::size_t features, std::size_t rungs)
    : budget_(budget), lambda_(std::numeric_limits<double>::infinity()) {
  constexpr double most = 1e6;
  if (!written.is_null("lambda")) lambda_ = written.number("lambda", 0, kLargestLambda);
  if (written.has("always") && !written.is_null("always"))
    always_ = static_cast<int>(written.integer("always", 0, static_cast<std::int64_t>(rungs) - 1));
  mean_ = written.numbers("feature_mean", features, -most, most);
  scale_ = written.numbers("feature_scale", features, 1e-12, most);
  const json& list = written.list("rungs", kMostRungs);
  if (list.size() != rungs) written.fail("rungs", fmt::format("has {} entries, not {}", list.size(), rungs));
  for (std::size_t r = 0; r < rungs; ++r) {
    const JsonFields rung = written.inner(fmt::format("rungs[{}]", r), list[r]);
    rungs_.push_back({rung.numbers("coefficients", features + 1, -most, most), rung.number("spread", 0, most),
                      rung.number("seconds", 0, most)});
  }
  order_by_cost();
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
  order_by_cost();
}

void BudgetRule::order_by_cost() {
  by_cost_.resize(rungs_.size());
  std::iota(by_cost_.begin(), by_cost_.end(), std::size_t{0});
  std::stable_sort(by_cost_.begin(), by_cost_.end(),
                   [&](std::size_t a, std::size_t b) { return rungs_[a].seconds < rungs_[b].seconds; });
}

/// From the largest λ down, as long as the bound holds.
void BudgetRule::calibrate(const std::vector<BudgetScene>& calibration, const Groups& groups,
                           const Predictions& left_out, double confidence) {
  for (int step = static_cast<int>(std::lround(kLargestLambda / kLambdaStep)); step >= 0; --step) {
    const double lambda = step * kLambdaStep;
    const auto is_beyond = [&](std::size_t i) {
      const int rung = choose(left_out[i], lambda);
      return rung >= 0 && calibration[i].errors[static_cast<std::size_t>(rung)] > budget_;
    };
    if (!is_backed(groups, confidence, is_beyond)) break;
    lambda_ = lambda;
  }
}

void BudgetRule::try_one_for_all(const std::vector<BudgetScene>& calibration, const Groups& groups,
                                 const Predictions& left_out, double confidence) {
  const auto n = static_cast<double>(calibration.size());
  double least = 0;  // what the rule costs
  for (std::size_t i = 0; i < calibration.size(); ++i) {
    const BudgetScene& scene = calibration[i];
    const int rung = choose(left_out[i], lambda_);
    least += rung >= 0 ? scene.seconds[static_cast<std::size_t>(rung)]
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
    x(0) = 1;
    for (Eigen::Index k = 1; k < size; ++k) x(k) = z[static_cast<std::size_t>(k) - 1];
    normal += x * x.transpose();
    right += logarithm(scene->errors[rung]) * x;
  }
  for (Eigen::Index k = 1; k < size; ++k) normal(k, k) += kRidge;
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
  auto rungs = json::array();
  for (const BudgetRule::Rung& rung : rule.rungs_)
    rungs.push_back(
        {{"seconds", rung.seconds}, {"spread", rung.spread}, {"coefficients", rung.coefficients}});
  return {{"lambda", std::isfinite(rule.lambda_) ? json(rule.lambda_) : json()},
          {"always", rule.always_ ? json(*rule.always_) : json()},
          {"feature_mean", rule.mean_},
          {"feature_scale", rule.scale_},
          {"rungs", rungs}};
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

}  // namespace mirage
