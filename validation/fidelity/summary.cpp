#include "validation/fidelity/summary.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <span>

#include "base/clustered_share.h"
#include "base/clusters.h"
#include "frames/hosts.h"
#include "validation/blender/unbiased_error.h"

namespace mirage {
namespace {

using nlohmann::json;

/// How many vehicles the adversary fools, seen by the rasteriser and by Cycles.
struct Fooled {
  int detected = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0, raster = 0, cycles = 0;

  void add(const SeenResult& seen) {
    if (!seen.detected) return;
    ++detected;
    hidden_raster += seen.raster.hidden;
    hidden_cycles += seen.cycles.hidden;
    hidden_both += seen.raster.hidden && seen.cycles.hidden;
    raster += seen.raster.fooled();
    cycles += seen.cycles.fooled();
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
  void add(const VehicleResult& vehicle, const SquaredError& error) {
    plain_ += error.plain;
    floor_ += error.floor;
    drawn_ += error.drawn;
    vehicles_.push_back({error.unbiased, 1});
    clusters_.add(cluster_of(vehicle.host.frame, vehicle.track), error.unbiased);
    picture_ = error.interval;
  }
  bool empty() const { return vehicles_.empty(); }
  json result() const {
    const auto n = static_cast<double>(vehicles_.size());
    const std::vector<ClusterSums> clusters = clusters_.sums();
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
    const Interval interval = drawn.size() > 1 ? bootstrap_statistic(drawn.size(), root_of_mean) : picture_;
    return {{"error_plain", signed_root(plain_ / n)},
            {"floor", signed_root(floor_ / n)},
            {"error_drawn", signed_root(drawn_ / n)},
            {"error_unbiased", interval.value},
            {"interval", to_json(interval)},
            {"interval_over", drawn.size() < 2 ? "pixels"
                              : by_cluster     ? "clusters"
                                               : "vehicles"}};
  }

 private:
  double plain_ = 0, floor_ = 0, drawn_ = 0;
  std::vector<ClusterSums> vehicles_;
  ClusteredShare clusters_;
  Interval picture_;
};

/// A rung over the vehicles that have it.
struct RungMeans {
  Means means;
  std::string group, base;
  Errors errors;
  int vehicles = 0, detected = 0, hidden = 0, false_positive = 0, either = 0;
  double score = 0, score_change = 0;

  void add(const VehicleResult& vehicle, const LightRungResult& rung) {
    group = rung.group, base = rung.base;
    errors.add(vehicle, rung.error);
    add_outcome(vehicle, rung.outcome);
    means.add(figures(rung));
  }
  void add(const VehicleResult& vehicle, const LidarRungResult& rung) {
    add_outcome(vehicle, rung.outcome);
    means.add(figures(rung));
  }
  void add_outcome(const VehicleResult& vehicle, const std::optional<OutcomeResult>& outcome) {
    ++vehicles;
    if (!outcome) return;
    ++detected;
    hidden += outcome->hidden;
    false_positive += outcome->false_positive;
    either += outcome->fooled();
    score += outcome->score;
    score_change += std::abs(outcome->score - vehicle.seen->raster.score);
  }
};

/// A ladder over the vehicles that have one, in the order of its rungs. What the detector says counts
/// vehicles found without the adversary.
template <class Rung>
json ladder(const std::vector<VehicleResult>& vehicles, std::vector<Rung> LadderResult::*which) {
  std::map<std::string, RungMeans> rungs;
  std::vector<std::string> order;
  for (const VehicleResult& vehicle : vehicles) {
    if (!vehicle.seen || !vehicle.seen->ladder) continue;
    for (const Rung& rung : (*vehicle.seen->ladder).*which) {
      const auto [place, added] = rungs.try_emplace(rung.effect);
      if (added) order.push_back(rung.effect);
      place->second.add(vehicle, rung);
    }
  }
  auto list = json::array();
  for (const std::string& effect : order) {
    const RungMeans& rung = rungs.at(effect);
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

json summarize_vehicles(const std::vector<VehicleResult>& all, const std::set<std::string>& test_frames) {
  std::set<std::string> frames;
  double both = 0, either = 0, error = 0, largest = 0, range_error = 0, worst_iou = 1;
  RooftopCount rooftops;
  int rays = 0, pixels_off = 0, returns = 0, disagreements = 0, vehicles = 0;
  Fooled held_back, trained_on;  // an attack is judged on vehicles that it never saw
  double full_mae = 0, full_mean = 0, full_ssim = 0, full_flip = 0, full_seconds = 0;
  double worst_depth = 0, noise = 0;
  Errors full_errors;
  for (const VehicleResult& vehicle : all) {
    if (!vehicle.seen) continue;
    const SeenResult& seen = *vehicle.seen;
    ++vehicles;
    ++(vehicle.from_box ? rooftops.from_box : rooftops.fitted);
    frames.insert(vehicle.host.frame);
    const MatchedResult& m = seen.matched;
    both += m.mask_both;
    either += m.mask_either;
    error += m.mae * m.mask_either;
    largest = std::max(largest, m.max_error);
    worst_iou = std::min(worst_iou, m.mask_iou);
    range_error = std::max(range_error, m.range_error);
    worst_depth = std::max(worst_depth, m.depth_error);
    noise += seen.full.noise;
    rays += m.rays;
    pixels_off += m.pixels_off;
    returns += m.returns;
    disagreements += m.hit_disagreements;
    full_errors.add(vehicle, seen.full.error);
    full_mae += seen.full.mae;
    full_mean += seen.full.mean;
    full_ssim += seen.full.ssim;
    full_flip += seen.full.flip;
    full_seconds += seen.full.seconds;
    (test_frames.contains(vehicle.host.frame) ? held_back : trained_on).add(seen);
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
          {"ladder", ladder(all, &LadderResult::light)},
          {"lidar_ladder", ladder(all, &LadderResult::lidar)},
          {"attack", held_back.to_json()},
          {"attack_train", trained_on.to_json()}};
}

}  // namespace mirage
