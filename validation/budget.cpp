#include "validation/budget.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include "base/bootstrap.h"
#include "base/clusters.h"
#include "base/color.h"
#include "base/error.h"
#include "base/random.h"
#include "validation/host_scene.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr double kRidge = 1;
constexpr double kFloor = 1e-4;  // error at which its logarithm levels off
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

  std::map<std::string, std::vector<std::size_t>> frames;
  for (std::size_t i = 0; i < calibration.size(); ++i) frames[calibration[i].frame].push_back(i);
  const auto all = pointers(calibration);
  std::vector<std::vector<double>> left_out(calibration.size(), std::vector<double>(rungs));
  for (std::size_t r = 0; r < rungs; ++r) rungs_.push_back(fit(all, r));
  for (const auto& [frame, members] : frames) {
    std::vector<const BudgetScene*> others;
    for (const BudgetScene* scene : all)
      if (scene->frame != frame) others.push_back(scene);
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
    for (const auto& [frame, members] : frames) {
      int beyond = 0;
      for (const std::size_t i : members) {
        const int rung = choose(left_out[i], lambda);
        beyond += rung >= 0 && calibration[i].errors[static_cast<std::size_t>(rung)] > budget;
      }
      risk += beyond / static_cast<double>(members.size());
    }
    if ((risk + 1) / (static_cast<double>(frames.size()) + 1) > 1 - confidence + 1e-12) break;
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
  if (scenes.empty()) normal(0, 0) = 1;  // nothing left when the only frame is left out: predicts log 1
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

json scene_features(const HostScene& scene, const Simulated& simulated) {
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
  std::vector<std::string> features, rungs;
  std::vector<BudgetScene> scenes;
};

Table read_scenes(const std::vector<json>& vehicles, BudgetOf of) {
  Table table;
  for (const json& vehicle : vehicles) {
    if (!vehicle.contains("ladder") || !vehicle.contains("features")) continue;
    if (of == BudgetOf::score && !vehicle.at("detected").get<bool>()) continue;
    BudgetScene scene;
    scene.frame = vehicle.at("frame");
    scene.track = vehicle.value("track", -1);
    scene.name = vehicle.at("name");
    std::vector<std::string> features, rungs;
    for (const auto& [name, value] : vehicle.at("features").items()) {
      features.push_back(name);
      scene.features.push_back(value.get<double>());
    }
    double light_weight = 0;  // the features' renders are paid for whatever is chosen
    for (const json& rung : vehicle.at("ladder")) {
      const auto effect = rung.at("effect").get<std::string>();
      if (effect == "hard" || effect == "soft" || effect == "visible light")
        light_weight += rung.at("seconds").get<double>();
    }
    for (const json& rung : vehicle.at("ladder")) {
      const auto effect = rung.at("effect").get<std::string>();
      if (kNotOffered.contains(effect)) continue;
      rungs.push_back(effect);
      scene.errors.push_back(
          of == BudgetOf::radiance
              ? rung.at("to_full").at("relative").get<double>()
              : std::abs(rung.at("score").get<double>() - vehicle.at("cycles").at("score").get<double>()));
      const bool ours = rung.at("group") == "raster";
      scene.seconds.push_back(light_weight + (ours ? 0 : rung.at("seconds").get<double>()));
    }
    scene.seconds_full = vehicle.at("reference").at("seconds");
    if (table.scenes.empty()) table.features = features, table.rungs = rungs;
    if (features == table.features && rungs == table.rungs) table.scenes.push_back(std::move(scene));
  }
  return table;
}

/// Frames of the calibration half, drawn by seed.
std::set<std::string> calibration_frames(const std::vector<BudgetScene>& scenes, std::uint64_t seed) {
  std::set<std::string> all;
  for (const BudgetScene& scene : scenes) all.insert(scene.frame);
  std::vector<std::string> order(all.begin(), all.end());
  RandomStream random(seed, "budget frames");
  for (std::size_t i = order.size(); i > 1; --i)
    std::swap(order[i - 1], order[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
  order.resize((order.size() + 1) / 2);
  return {order.begin(), order.end()};
}

/// Cheapest rung that does keep the budget: what nothing can beat.
int oracle(const BudgetScene& scene, double budget) {
  int best = -1;
  for (std::size_t r = 0; r < scene.errors.size(); ++r)
    if (scene.errors[r] <= budget && scene.seconds[r] < scene.seconds_full &&
        (best < 0 || scene.seconds[r] < scene.seconds[static_cast<std::size_t>(best)]))
      best = static_cast<int>(r);
  return best;
}

struct Tally {
  std::map<std::string, ClusterSums> within;  ///< by cluster
  std::set<std::string> frames;
  double seconds = 0, seconds_full = 0;
  std::map<std::string, int> chosen;
  int vehicles = 0;

  json result() const {
    std::vector<ClusterSums> clusters;
    for (const auto& [name, sums] : within) clusters.push_back(sums);
    return {{"frames", frames.size()},
            {"vehicles", vehicles},
            {"within", to_json(bootstrap_interval(clusters))},
            {"seconds", seconds / std::max(1, vehicles)},
            {"seconds_full", seconds_full / std::max(1, vehicles)},
            {"saved", seconds_full > 0 ? 1 - seconds / seconds_full : 0},
            {"chosen", chosen}};
  }
};

}  // namespace

json choose_rungs(const std::vector<json>& vehicles, const BudgetSettings& settings) {
  const Table table = read_scenes(vehicles, settings.of);
  json result = {
      {"budget", settings.budget},
      {"of", settings.of == BudgetOf::radiance ? "radiance" : "score"},
      {"confidence", settings.confidence},
      {"features", table.features},
      {"rule",
       "ridge regression of each rung's log error on standardised features; the cheapest rung whose "
       "prediction plus lambda times its spread is within the budget, else the reference; lambda by "
       "conformal risk "
       "control over the calibration frames"}};
  const std::set<std::string> frames = calibration_frames(table.scenes, settings.seed);
  std::vector<BudgetScene> calibration;
  for (const BudgetScene& scene : table.scenes)
    if (frames.contains(scene.frame)) calibration.push_back(scene);
  if (calibration.empty() || calibration.size() == table.scenes.size()) {
    result["problem"] = "too few frames to calibrate on some and test on others";
    return result;
  }
  const BudgetRule rule(calibration, settings.budget, settings.confidence);
  result.update(rule.numbers());
  for (std::size_t r = 0; r < table.rungs.size(); ++r) result["rungs"][r]["name"] = table.rungs[r];
  Tally halves[2], best[2];
  result["scenes"] = json::array();
  for (const BudgetScene& scene : table.scenes) {
    const bool tested = !frames.contains(scene.frame);
    const auto score = [&](Tally& tally, int rung, double own_cost) {
      const double error = rung < 0 ? 0 : scene.errors[static_cast<std::size_t>(rung)];
      const double seconds =
          rung < 0 ? own_cost + scene.seconds_full : scene.seconds[static_cast<std::size_t>(rung)];
      ++tally.vehicles;
      ClusterSums& sums = tally.within[cluster_of(scene.frame, scene.track)];
      tally.frames.insert(scene.frame);
      sums.numerator += error <= settings.budget;
      sums.denominator += 1;
      tally.seconds += seconds;
      tally.seconds_full += scene.seconds_full;
      const std::string name = rung < 0 ? "reference" : table.rungs[static_cast<std::size_t>(rung)];
      ++tally.chosen[name];
      return json{{"name", scene.name},
                  {"frame", scene.frame},
                  {"split", tested ? "test" : "calibration"},
                  {"chosen", name},
                  {"error", error},
                  {"within", error <= settings.budget},
                  {"seconds", seconds},
                  {"seconds_full", scene.seconds_full}};
    };
    const double features_cost = *std::min_element(scene.seconds.begin(), scene.seconds.end());
    result["scenes"].push_back(score(halves[tested], rule.choose(scene.features), features_cost));
    score(best[tested], oracle(scene, settings.budget), 0);
  }
  result["calibration"] = halves[0].result();
  result["test"] = halves[1].result();
  result["test"]["oracle"] = best[1].result();
  return result;
}

}  // namespace mirage
