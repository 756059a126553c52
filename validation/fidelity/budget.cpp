#include "validation/fidelity/budget.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include "base/clustered_share.h"
#include "base/color.h"
#include "base/error.h"
#include "base/random.h"
#include "base/shuffle.h"
#include "validation/blender/host_scene.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr double kRidge = 1;
constexpr double kFloor = 1e-4;  // error at which its logarithm levels off
constexpr int kFolds = 20;
constexpr double kLargestLambda = 8, kLambdaStep = 0.05;
/// Rungs that are no approximation of the full render.
const std::set<std::string> kNotOffered = {"sRGB shading", "+clear sky", "+car paint"};

double logarithm(double error) {
  return std::log(error + kFloor);
}

std::vector<const BudgetScene*> pointers(const std::vector<BudgetScene>& scenes) {
  std::vector<const BudgetScene*> list;
  for (const BudgetScene& scene : scenes) list.push_back(&scene);
  return list;
}

}  // namespace

BudgetOf parse_budget_of(const std::string& word) {
  if (word == "radiance") return BudgetOf::radiance;
  if (word == "score") return BudgetOf::score;
  throw InputError("--budget-of", word, "unknown choice", "use radiance or score");
}

BudgetRule::BudgetRule(const std::vector<BudgetScene>& calibration, double budget, double confidence)
    : budget_(budget) {
  const std::size_t features = calibration.at(0).features.size(), rungs = calibration.at(0).errors.size();
  const auto n = static_cast<double>(calibration.size());
  mean_.assign(features, 0);
  scale_.assign(features, 0);
  for (const BudgetScene& scene : calibration)
    for (std::size_t k = 0; k < features; ++k) mean_[k] += scene.features[k] / n;
  for (const BudgetScene& scene : calibration)
    for (std::size_t k = 0; k < features; ++k)
      scale_[k] += (scene.features[k] - mean_[k]) * (scene.features[k] - mean_[k]) / n;
  for (double& scale : scale_) scale = scale > 1e-18 ? std::sqrt(scale) : 1;  // a constant one says nothing

  std::map<std::string, std::vector<std::size_t>> groups;
  for (std::size_t i = 0; i < calibration.size(); ++i) groups[calibration[i].group].push_back(i);
  const auto all = pointers(calibration);
  std::vector<std::vector<double>> left_out(calibration.size(), std::vector<double>(rungs));
  for (std::size_t r = 0; r < rungs; ++r) rungs_.push_back(fit(all, r));
  for (const auto& [group, members] : groups) {
    std::vector<const BudgetScene*> others;
    for (const BudgetScene* scene : all)
      if (scene->group != group) others.push_back(scene);
    for (std::size_t r = 0; r < rungs; ++r) {
      const Rung fitted = fit(others, r);
      for (const std::size_t i : members) left_out[i][r] = predict(fitted, calibration[i].features);
    }
  }
  for (std::size_t r = 0; r < rungs; ++r) {
    double sum = 0;
    for (std::size_t i = 0; i < calibration.size(); ++i) {
      const double residual = logarithm(calibration[i].errors[r]) - left_out[i][r];
      sum += residual * residual / n;
      rungs_[r].seconds += calibration[i].seconds[r] / n;
    }
    rungs_[r].spread = std::sqrt(sum);
  }
  by_cost_.resize(rungs);
  std::iota(by_cost_.begin(), by_cost_.end(), std::size_t{0});
  std::stable_sort(by_cost_.begin(), by_cost_.end(),
                   [&](std::size_t a, std::size_t b) { return rungs_[a].seconds < rungs_[b].seconds; });

  // From the largest λ down, as long as the bound holds.
  lambda_ = std::numeric_limits<double>::infinity();
  for (int step = static_cast<int>(std::lround(kLargestLambda / kLambdaStep)); step >= 0; --step) {
    const double lambda = step * kLambdaStep;
    double risk = 0;
    for (const auto& [group, members] : groups) {
      int beyond = 0;
      for (const std::size_t i : members) {
        const int rung = choose(left_out[i], lambda);
        beyond += rung >= 0 && calibration[i].errors[static_cast<std::size_t>(rung)] > budget;
      }
      risk += beyond / static_cast<double>(members.size());
    }
    if ((risk + 1) / (static_cast<double>(groups.size()) + 1) > 1 - confidence + 1e-12) break;
    lambda_ = lambda;
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
  std::vector<double> predictions;
  for (const Rung& rung : rungs_) predictions.push_back(predict(rung, features));
  return choose(predictions, lambda_);
}

json BudgetRule::numbers() const {
  auto rungs = json::array();
  for (const Rung& rung : rungs_)
    rungs.push_back(
        {{"seconds", rung.seconds}, {"spread", rung.spread}, {"coefficients", rung.coefficients}});
  return {{"lambda", std::isfinite(lambda_) ? json(lambda_) : json()},
          {"feature_mean", mean_},
          {"feature_scale", scale_},
          {"rungs", rungs}};
}

std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated) {
  const Frame& frame = scene.prepared->frame;
  const Lighting& light = frame.lighting;
  const Vec3d roof = bounds(scene.placed.mesh).center();
  const Vec3d to_camera = frame.calibration.camera_from_velo.inverse().translation() - roof;
  const double yaw = scene.host->box.bev.yaw;
  const auto cosine = [](const Vec3d& a, const Vec3d& b) {
    const double lengths = a.head<2>().norm() * b.head<2>().norm();
    return lengths > 1e-9 ? a.head<2>().dot(b.head<2>()) / lengths : 0;
  };
  const auto brightness = [](const Vec3d& rgb) { return rgb.mean(); };
  const double sun = brightness(light.sun) * std::max(0.0, light.to_sun_velo.z()),
               sky = brightness(light.ambient + light.hemisphere);
  return {{"sun_elevation", std::asin(std::clamp(light.to_sun_velo.z(), -1.0, 1.0))},
          {"sun_behind_camera", cosine(light.to_sun_velo, to_camera)},
          {"sun_along_heading", cosine(light.to_sun_velo, Vec3d(std::cos(yaw), std::sin(yaw), 0))},
          {"sun_share", sun + sky > 0 ? sun / (sun + sky) : 0},
          {"roof_height", bounds(scene.placed.mesh).min().z() - scene.host->box.bottom},
          {"range", std::hypot(scene.host->box.bev.x, scene.host->box.bev.y)},
          {"camera_elevation", std::atan2(to_camera.z(), to_camera.head<2>().norm())},
          {"log_pixels", std::log(1.0 + simulated.adversary_pixels)},
          {"visible_share", simulated.visible_share}};
}

namespace {

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
      if (rung.effect == "hard" || rung.effect == "soft" || rung.effect == "visible light")
        light_weight += rung.seconds;
    for (const LightRungResult& rung : ladder.light) {
      if (kNotOffered.contains(rung.effect)) continue;
      rungs.push_back(rung.effect);
      scene.errors.push_back(of == BudgetOf::radiance ? std::max(0.0, signed_root(rung.error.drawn))
                                                      : std::abs(rung.outcome->score - seen.cycles.score));
      scene.alone.push_back(rung.seconds);
      scene.seconds.push_back(light_weight + (rung.group == "raster" ? 0 : rung.seconds));
    }
    scene.seconds_full = ladder.reference_seconds;
    scene.error_full = of == BudgetOf::radiance ? ladder.reference_noise : 0;
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

  void add(const BudgetScene& scene, double error, double cost, const std::string& rung, double budget) {
    ++vehicles;
    within.add(scene.group, error <= budget);
    seconds += cost;
    ++chosen[rung];
  }
  json result() const {
    return {{"within", to_json(within.interval())},
            {"seconds", seconds / std::max(1, vehicles)},
            {"chosen", chosen}};
  }
};

}  // namespace

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

json choose_rungs(const std::vector<VehicleResult>& vehicles, const BudgetSettings& settings) {
  const Table table = read_scenes(vehicles, settings.of);
  json result = {
      {"budget", settings.budget},
      {"of", settings.of == BudgetOf::radiance ? "radiance" : "score"},
      {"confidence", settings.confidence},
      {"features", table.features},
      {"rule",
       "ridge regression of each rung's log error on standardised features; the cheapest rung whose "
       "prediction plus lambda times its spread is within the budget, else the reference; lambda by "
       "conformal risk control over the groups that it is not tested on"}};
  const std::map<std::string, int> folds = folds_of(table.scenes, settings.seed);
  const auto count = static_cast<int>(std::min<std::size_t>(folds.size(), kFolds));
  result["groups"] = {
      {"by", table.by_vehicle ? "vehicle" : "frame"}, {"count", folds.size()}, {"folds", count}};
  if (count < 2) {
    result["problem"] = "too few frames to calibrate on some and test on others";
    return result;
  }
  const BudgetRule whole(table.scenes, settings.budget, settings.confidence);
  result.update(whole.numbers());
  for (std::size_t r = 0; r < table.rungs.size(); ++r) result["rungs"][r]["name"] = table.rungs[r];
  Tally ruled, fixed, best;
  std::set<std::string> frames;
  result["scenes"] = json::array();
  for (int fold = 0; fold < count; ++fold) {
    std::vector<BudgetScene> others;
    for (const BudgetScene& scene : table.scenes)
      if (folds.at(scene.group) != fold) others.push_back(scene);
    const BudgetRule rule(others, settings.budget, settings.confidence);
    const int always = fixed_rung(others, settings);
    for (const BudgetScene& scene : table.scenes) {
      if (folds.at(scene.group) != fold) continue;
      frames.insert(scene.frame);
      const auto take = [&](Tally& tally, int rung, const std::vector<double>& costs, double own_cost) {
        const auto r = static_cast<std::size_t>(std::max(0, rung));
        const double error = rung < 0 ? scene.error_full : scene.errors[r],
                     seconds = rung < 0 ? own_cost + scene.seconds_full : costs[r];
        const std::string name = rung < 0 ? "reference" : table.rungs[r];
        tally.add(scene, error, seconds, name, settings.budget);
        return json{
            {"chosen", name}, {"error", error}, {"within", error <= settings.budget}, {"seconds", seconds}};
      };
      const double features_cost = *std::min_element(scene.seconds.begin(), scene.seconds.end());
      json entry = take(ruled, rule.choose(scene.features), scene.seconds, features_cost);
      entry["seconds_fixed"] = take(fixed, always, scene.alone, 0).at("seconds");
      take(best, oracle(scene, settings.budget), scene.alone, 0);
      entry.update({{"name", scene.name}, {"frame", scene.frame}, {"group", scene.group}, {"fold", fold}});
      result["scenes"].push_back(std::move(entry));
    }
  }
  json& test = result["test"] = ruled.result();
  const auto saved = [&](const Tally& tally) {
    return fixed.seconds > 0 ? 1 - tally.seconds / fixed.seconds : 0;
  };
  test.update({{"frames", frames.size()},
               {"vehicles", ruled.vehicles},
               {"kept", test.at("within").at("value").get<double>() >= settings.confidence},
               {"saved", saved(ruled)},
               {"fixed", fixed.result()},
               {"oracle", best.result()}});
  test["oracle"]["saved"] = saved(best);
  return result;
}

}  // namespace mirage
