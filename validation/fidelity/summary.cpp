#include "validation/fidelity/summary.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <span>

#include "base/bootstrap.h"
#include "base/clusters.h"
#include "frames/hosts.h"
#include "validation/blender/unbiased_error.h"

namespace mirage {
namespace {

using nlohmann::json;

/// How many vehicles the adversary fools, seen by the rasteriser and by Cycles.
struct Fooled {
  int detected = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0, raster = 0, cycles = 0;

  void add(const json& host) {
    if (!host.at("detected").get<bool>()) return;
    ++detected;
    const bool in_raster = host.at("raster").at("hidden"), in_cycles = host.at("cycles").at("hidden");
    hidden_raster += in_raster;
    hidden_cycles += in_cycles;
    hidden_both += in_raster && in_cycles;
    raster += in_raster || host.at("raster").at("false_positive").get<bool>();
    cycles += in_cycles || host.at("cycles").at("false_positive").get<bool>();
  }
  json to_json() const {
    const double base = std::max(1, detected);
    return {{"detected_clean", detected},
            {"hidden_raster", hidden_raster},
            {"hidden_cycles", hidden_cycles},
            {"hidden_both", hidden_both},
            {"fn_asr_raster", hidden_raster / base},
            {"fn_asr_cycles", hidden_cycles / base},
            {"asr_raster", raster / base},
            {"asr_cycles", cycles / base}};
  }
};

/// Means of whatever numbers stand in the rungs' objects, by key; a number that is null somewhere (PSNR of
/// equal pictures) is the mean of the others.
class Means {
 public:
  void add(const json& object) {
    for (const auto& [key, value] : object.items()) {
      if (value.is_object()) nested_[key].add(value);
      if (!value.is_number() || value.is_boolean()) continue;
      auto& [count, sum] = sums_[key];
      ++count;
      sum += value.get<double>();
    }
  }
  json result() const {
    json means = json::object();
    for (const auto& [key, sum] : sums_) means[key] = sum.second / sum.first;
    for (const auto& [key, object] : nested_) means[key] = object.result();
    return means;
  }

 private:
  std::map<std::string, std::pair<int, double>> sums_;
  std::map<std::string, Means> nested_;
};

/// Squared errors (unbiased_error.h) over vehicles: their means, as roots, and the interval of the unbiased
/// one by the bootstrap over clusters (base/clusters.h); of a single cluster over its vehicles, of a single
/// vehicle over its picture.
class Errors {
 public:
  void add(const json& vehicle, const json& error) {
    const json& squared = error.at("squared");
    plain_ += squared.at("plain").get<double>();
    floor_ += squared.at("floor").get<double>();
    drawn_ += squared.at("drawn").get<double>();
    const auto unbiased = squared.at("unbiased").get<double>();
    vehicles_.push_back({unbiased, 1});
    ClusterSums& cluster =
        clusters_[cluster_of(vehicle.at("frame").get<std::string>(), vehicle.value("track", -1))];
    cluster.numerator += unbiased;
    cluster.denominator += 1;
    picture_ = error.at("interval");
  }
  bool empty() const { return vehicles_.empty(); }
  json result() const {
    const auto n = static_cast<double>(vehicles_.size());
    std::vector<ClusterSums> clusters;
    for (const auto& [name, sums] : clusters_) clusters.push_back(sums);
    const bool by_cluster = clusters.size() > 1;
    const std::vector<ClusterSums>& drawn = by_cluster ? clusters : vehicles_;
    const auto root_of_mean = [&](std::span<const int> count) {
      ClusterSums sums;
      for (std::size_t i = 0; i < drawn.size(); ++i) {
        sums.numerator += count[i] * drawn[i].numerator;
        sums.denominator += count[i] * drawn[i].denominator;
      }
      return signed_root(sums.numerator / sums.denominator);
    };
    json interval = picture_;
    if (drawn.size() > 1) interval = to_json(bootstrap_statistic(drawn.size(), root_of_mean));
    return {{"error_plain", signed_root(plain_ / n)},
            {"floor", signed_root(floor_ / n)},
            {"error_drawn", signed_root(drawn_ / n)},
            {"error_unbiased", interval.at("value")},
            {"interval", interval},
            {"interval_over", drawn.size() < 2 ? "pixels"
                              : by_cluster     ? "clusters"
                                               : "vehicles"}};
  }

 private:
  double plain_ = 0, floor_ = 0, drawn_ = 0;
  std::vector<ClusterSums> vehicles_;
  std::map<std::string, ClusterSums> clusters_;
  json picture_;
};

/// A ladder over the vehicles that have one, in the order of its rungs. What the detector says counts
/// vehicles found without the adversary.
json ladder(const std::vector<json>& hosts, const char* key) {
  struct Rung {
    Means means;
    std::string group, base;
    Errors errors;
    int vehicles = 0, detected = 0, hidden = 0, false_positive = 0, either = 0;
    double score = 0, score_change = 0;
  };
  std::map<std::string, Rung> rungs;
  std::vector<std::string> order;
  for (const json& host : hosts)
    for (json entry : host.value(key, json::array())) {
      const auto effect = entry.at("effect").get<std::string>();
      auto [place, added] = rungs.try_emplace(effect);
      if (added) order.push_back(effect);
      Rung& rung = place->second;
      ++rung.vehicles;
      rung.group = entry.value("group", "");
      rung.base = entry.value("base", "");
      if (entry.contains("score")) {
        const bool hidden = entry.at("hidden"), false_positive = entry.at("false_positive");
        ++rung.detected;
        rung.hidden += hidden;
        rung.false_positive += false_positive;
        rung.either += hidden || false_positive;
        rung.score += entry.at("score").get<double>();
        rung.score_change +=
            std::abs(entry.at("score").get<double>() - host.at("raster").at("score").get<double>());
      }
      if (entry.contains("squared")) rung.errors.add(host, entry);
      for (const char* own : {"score", "iou", "effect", "group", "base", "squared", "error_plain", "floor",
                              "error_drawn", "error_unbiased", "interval"})
        entry.erase(own);
      rung.means.add(entry);
    }
  auto list = json::array();
  for (const std::string& effect : order) {
    const Rung& rung = rungs.at(effect);
    json entry = rung.means.result();
    const double base = std::max(1, rung.detected);
    entry.update({{"effect", effect},
                  {"vehicles", rung.vehicles},
                  {"detected", rung.detected},
                  {"hidden", rung.hidden},
                  {"false_positive", rung.false_positive},
                  {"fn_asr", rung.hidden / base},
                  {"asr", rung.either / base},
                  {"mean_score", rung.score / base},
                  {"score_change", rung.score_change / base}});
    if (!rung.errors.empty()) entry.update(rung.errors.result());
    if (!rung.group.empty()) entry["group"] = rung.group;
    if (!rung.base.empty()) entry["base"] = rung.base;
    list.push_back(entry);
  }
  return list;
}

}  // namespace

json summarize_vehicles(const std::vector<json>& hosts, const std::set<std::string>& test_frames) {
  std::set<std::string> frames;
  double both = 0, either = 0, error = 0, largest = 0, range_error = 0, worst_iou = 1;
  RooftopCount rooftops;
  int rays = 0, pixels_off = 0, returns = 0, disagreements = 0, vehicles = 0;
  Fooled held_back, trained_on;  // an attack is judged on vehicles that it never saw
  double full_mae = 0, full_mean = 0, full_ssim = 0, full_flip = 0, full_seconds = 0;
  double worst_depth = 0, noise = 0;
  Errors full_errors;
  for (const json& host : hosts) {
    if (!host.contains("matched")) continue;
    ++vehicles;
    ++(host.at("from_box").get<bool>() ? rooftops.from_box : rooftops.fitted);
    frames.insert(host.at("frame").get<std::string>());
    const json& m = host.at("matched");
    both += m.at("mask_both").get<double>();
    either += m.at("mask_either").get<double>();
    error += m.at("mae").get<double>() * m.at("mask_either").get<double>();
    largest = std::max(largest, m.at("max_error").get<double>());
    worst_iou = std::min(worst_iou, m.at("mask_iou").get<double>());
    range_error = std::max(range_error, m.at("range_error_m").get<double>());
    worst_depth = std::max(worst_depth, m.at("depth_error_m").get<double>());
    noise += host.at("full").at("noise").get<double>();
    rays += m.at("rays").get<int>();
    pixels_off += m.at("pixels_off").get<int>();
    returns += m.at("returns").get<int>();
    disagreements += m.at("hit_disagreements").get<int>();
    const json& full = host.at("full");
    if (full.contains("squared")) full_errors.add(host, full);
    full_mae += full.at("mae").get<double>();
    full_mean += full.at("mean").get<double>();
    full_ssim += full.at("ssim").get<double>();
    full_flip += full.at("flip").get<double>();
    full_seconds += full.at("seconds").get<double>();
    (test_frames.count(host.at("frame").get<std::string>()) ? held_back : trained_on).add(host);
  }
  const double n = std::max(1, vehicles);
  const auto tested =
      std::count_if(frames.begin(), frames.end(), [&](const auto& f) { return test_frames.count(f); });
  json full = {{"mae", full_mae / n},
               {"relative", full_mean > 0 ? full_mae / full_mean : 0},
               {"ssim", full_ssim / n},
               {"flip", full_flip / n},
               {"seconds", full_seconds / n}};
  if (!full_errors.empty()) full.update(full_errors.result());
  return {{"frames", frames.size()},
          {"test_frames", tested},
          {"vehicles", vehicles},
          {"rooftops", to_json(rooftops)},
          {"matched",
           {{"mask_iou", either > 0 ? both / either : 1},
            {"mask_iou_worst", worst_iou},
            {"mae", either > 0 ? error / either : 0},
            {"max_error", largest},
            {"depth_error_m", worst_depth},
            {"pixels", either},
            {"pixels_off", pixels_off},
            {"range_error_m", range_error},
            {"hit_disagreements", disagreements},
            {"rays", rays},
            {"returns", returns}}},
          {"full", full},
          {"noise", noise / n},
          {"ladder", ladder(hosts, "ladder")},
          {"lidar_ladder", ladder(hosts, "lidar_ladder")},
          {"attack", held_back.to_json()},
          {"attack_train", trained_on.to_json()}};
}

}  // namespace mirage
