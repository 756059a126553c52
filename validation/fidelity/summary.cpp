#include "validation/fidelity/summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "base/fields.h"
#include "base/json_fields.h"
#include "detection/reliance.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

using Vehicles = std::vector<const VehicleResult*>;

std::string own_cluster(const VehicleResult& vehicle) {
  return cluster_of(vehicle.host.frame, vehicle.track);
}

/// Outcomes, counted.
struct OutcomeTally {
  int vehicles = 0;
  double score = 0;
  ClusteredShare hidden, false_positive, fooled;

  void add(const std::string& cluster, const OutcomeResult& outcome) {
    ++vehicles;
    score += outcome.score;
    hidden.add(cluster, outcome.hidden);
    false_positive.add(cluster, outcome.false_positive);
    fooled.add(cluster, outcome.fooled());
  }
  Success success() const {
    return {{hidden.interval(), false_positive.interval(), fooled.interval()},
            vehicles,
            score / std::max(1, vehicles)};
  }
};

/// Outcomes against others on the same vehicles.
struct Paired {
  OutcomeTally tally, base;
  int flips = 0;
  double logit = 0, score = 0;  ///< sums of |Δ|

  void add(const std::string& cluster, const OutcomeResult& outcome, const OutcomeResult& other) {
    tally.add(cluster, outcome);
    base.add(cluster, other);
    flips += outcome.hidden != other.hidden || outcome.false_positive != other.false_positive;
    logit += std::abs(outcome.logit - other.logit);
    score += std::abs(outcome.score - other.score);
  }
  SuccessShares difference() const {
    return {share_difference(tally.hidden, base.hidden),
            share_difference(tally.false_positive, base.false_positive),
            share_difference(tally.fooled, base.fooled)};
  }
};

/// The vehicles' conditions or controls against their first condition, in the order of their coming.
template <class Key, class Entry>
std::vector<Compared<Key>> compared(const Vehicles& vehicles, std::vector<Entry> VerdictResults::*which) {
  std::vector<std::pair<Key, Paired>> all;
  for (const VehicleResult* vehicle : vehicles) {
    if (!vehicle->seen->conditions) continue;
    const VerdictResults& verdicts = *vehicle->seen->conditions;
    for (const auto& [key, outcome] : verdicts.*which) {
      const Key& wanted = key;
      auto place = std::find_if(all.begin(), all.end(), [&](const auto& of) { return of.first == wanted; });
      if (place == all.end()) place = all.insert(all.end(), {key, Paired()});
      place->second.add(own_cluster(*vehicle), outcome, verdicts.conditions.at(0).outcome);
    }
  }
  constexpr bool kConditions =
      std::is_same_v<Key, RenderCondition>;  // whose first is not compared with itself
  std::vector<Compared<Key>> list;
  for (const auto& [key, paired] : all) {
    const double n = paired.tally.vehicles;
    const std::optional<Interval> difference =
        kConditions && list.empty() ? std::nullopt : std::optional(paired.difference().asr);
    list.push_back(
        {paired.tally.success(), key, difference, paired.flips, paired.logit / n, paired.score / n});
  }
  return list;
}

/// Pearson's; empty if one of the two does not vary.
std::optional<double> correlation(const std::vector<std::pair<double, double>>& pairs) {
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  for (const auto& [x, y] : pairs) mx += x, my += y;
  const auto n = static_cast<double>(pairs.size());
  mx /= n, my /= n;
  for (const auto& [x, y] : pairs) {
    xx += (x - mx) * (x - mx);
    yy += (y - my) * (y - my);
    xy += (x - mx) * (y - my);
  }
  if (pairs.size() < 2 || !(xx > 0) || !(yy > 0)) return std::nullopt;
  return xy / std::sqrt(xx * yy);
}

/// Each way of drawing the object, by kind, rungs in the order of their coming.
std::vector<VerdictVariant> variants_of(const Vehicles& vehicles) {
  struct Drawn {
    VariantKind kind;
    std::string name;
    OutcomeTally tally;
  };
  std::vector<Drawn> all;
  for (const VehicleResult* vehicle : vehicles) {
    const SeenResult& seen = *vehicle->seen;
    const auto add = [&](VariantKind kind, const std::string& name, const OutcomeResult& outcome) {
      auto place = std::find_if(all.begin(), all.end(), [&](const Drawn& of) { return of.name == name; });
      if (place == all.end()) place = all.insert(all.end(), {kind, name, {}});
      place->tally.add(own_cluster(*vehicle), outcome);
    };
    add(VariantKind::soft, "soft", seen.raster);
    add(VariantKind::hard, "hard", seen.hard);
    add(VariantKind::cycles, "cycles", seen.cycles);
    if (!seen.ladder) continue;
    for (const LightRungResult& rung : seen.ladder->light)
      if (rung.outcome && rung.effect != "soft" && rung.effect != "hard" && rung.effect != "full")
        add(VariantKind::rung, rung.effect, *rung.outcome);
  }
  std::stable_sort(all.begin(), all.end(), [](const Drawn& a, const Drawn& b) { return a.kind < b.kind; });
  std::vector<VerdictVariant> list;
  for (const Drawn& of : all) list.push_back({of.tally.success(), of.kind, of.name});
  return list;
}

VerdictGroup group(const Vehicles& vehicles) {
  std::set<std::string> frames;
  Clusters clusters;
  std::vector<std::pair<double, double>> scores;
  Paired cycles;  // against soft
  for (const VehicleResult* vehicle : vehicles) {
    const SeenResult& seen = *vehicle->seen;
    frames.insert(vehicle->host.frame);
    clusters.add(vehicle->host.frame, vehicle->track);
    cycles.add(own_cluster(*vehicle), seen.cycles, seen.raster);
    scores.emplace_back(seen.raster.score, seen.cycles.score);
  }
  const int count = cycles.tally.vehicles;
  const double n = std::max(1, count);
  return {static_cast<int>(frames.size()),
          count,
          clusters.count(),
          variants_of(vehicles),
          compared<RenderCondition>(vehicles, &VerdictResults::conditions),
          cycles.difference(),
          (count - cycles.flips) / n,
          correlation(scores),
          cycles.score / n};
}

VerdictFlip flip_of(const VehicleResult& vehicle, const std::string& split) {
  const SeenResult& seen = *vehicle.seen;
  VerdictFlip flip{vehicle.name, vehicle.host.frame, split, seen.range, seen.raster, seen.cycles, {}};
  for (const char* name : {"attacked", "cycles", "raster_crop", "cycles_crop", "difference"})
    if (const auto file = seen.pictures.find(name); file != seen.pictures.end()) flip.pictures.insert(*file);
  return flip;
}

/// The mean over the entries that have a value; empty if no entry has one.
template <class Entry, class Value>
std::optional<double> mean(const std::vector<Entry>& entries, const Value& value_of) {
  double sum = 0;
  int count = 0;
  for (const Entry& entry : entries)
    if (const std::optional<double> value = value_of(entry)) sum += *value, ++count;
  return count > 0 ? std::optional(sum / count) : std::nullopt;
}

/// Squared errors of vehicles, to be pooled.
class Errors {
 public:
  void add(const VehicleResult& vehicle, const SquaredError& error) {
    plain_ += error.plain;
    floor_ += error.floor;
    drawn_ += error.drawn;
    vehicles_.add(std::to_string(vehicles_.sums().size()), error.unbiased);
    clusters_.add(cluster_of(vehicle.host.frame, vehicle.track), error.unbiased);
    picture_ = error.interval;
  }
  /// Of at least one vehicle.
  PooledError pooled() const {
    const auto n = static_cast<double>(vehicles_.sums().size());
    const bool by_cluster = clusters_.sums().size() > 1, alone = n < 2;
    const ClusteredShare& over = by_cluster ? clusters_ : vehicles_;
    return {signed_root(plain_ / n), signed_root(floor_ / n), signed_root(drawn_ / n),
            alone ? picture_ : signed_root(over.mean_interval()),
            alone        ? IntervalBasis::pixels
            : by_cluster ? IntervalBasis::clusters
                         : IntervalBasis::vehicles};
  }

 private:
  double plain_ = 0, floor_ = 0, drawn_ = 0;
  ClusteredShare vehicles_, clusters_;
  Interval picture_;
};

/// A vehicle's rung.
template <class Rung>
struct RungOf {
  const VehicleResult* vehicle = nullptr;
  const Rung* rung = nullptr;
};

template <class Rung>
RungSummary outcomes(const std::vector<RungOf<Rung>>& rungs) {
  RungSummary sum;
  sum.effect = rungs.front().rung->effect;
  sum.vehicles = static_cast<int>(rungs.size());
  int fooled = 0;
  for (const auto& [vehicle, rung] : rungs) {
    const std::optional<OutcomeResult>& outcome = rung->outcome;
    if (!outcome) continue;
    ++sum.detected;
    sum.hidden += outcome->hidden;
    sum.false_positive += outcome->false_positive;
    fooled += outcome->fooled();
    sum.mean_score += outcome->score;
    sum.score_change += std::abs(outcome->score - vehicle->seen->raster.score);
  }
  const double base = std::max(1, sum.detected);
  sum.fn_asr = sum.hidden / base;
  sum.asr = fooled / base;
  sum.mean_score /= base;
  sum.score_change /= base;
  sum.seconds = *mean(rungs, [](const auto& of) { return of.rung->seconds; });
  sum.logit = mean(rungs, [](const auto& of) {
    return of.rung->outcome ? std::optional(of.rung->outcome->logit) : std::nullopt;
  });
  return sum;
}

MeanChange mean_change(const std::vector<RungOf<LightRungResult>>& rungs, Change LightRungResult::*which) {
  const auto of = [&](double Change::*number) {
    return *mean(rungs, [&](const auto& entry) { return (entry.rung->*which).*number; });
  };
  const auto psnr = mean(rungs, [&](const auto& entry) {
    const double value = (entry.rung->*which).psnr;
    return std::isfinite(value) ? std::optional(value) : std::nullopt;
  });
  return {of(&Change::mae), of(&Change::relative), of(&Change::ssim), of(&Change::flip), psnr};
}

LightRungSummary summary_of(const std::vector<RungOf<LightRungResult>>& rungs) {
  Errors errors;
  for (const auto& [vehicle, rung] : rungs) errors.add(*vehicle, rung->error);
  const LightRungResult& first = *rungs.front().rung;
  return {outcomes(rungs),
          first.group,
          first.base,
          mean_change(rungs, &LightRungResult::change),
          mean_change(rungs, &LightRungResult::crop),
          mean_change(rungs, &LightRungResult::to_full),
          errors.pooled()};
}

LidarRungSummary summary_of(const std::vector<RungOf<LidarRungResult>>& rungs) {
  return {outcomes(rungs), *mean(rungs, [](const auto& of) { return of.rung->returns; }),
          *mean(rungs, [](const auto& of) { return of.rung->changed; }),
          *mean(rungs, [](const auto& of) { return of.rung->returns_change; })};
}

/// A ladder over the vehicles that have one, in the order of its rungs.
template <class Summary, class Rung>
std::vector<Summary> ladder(const Vehicles& vehicles, std::vector<Rung> LadderResult::*which) {
  std::vector<std::vector<RungOf<Rung>>> effects;
  for (const VehicleResult* vehicle : vehicles) {
    if (!vehicle->seen->ladder) continue;
    for (const Rung& rung : (*vehicle->seen->ladder).*which) {
      const auto same = [&](const auto& rungs) { return rungs.front().rung->effect == rung.effect; };
      auto place = std::find_if(effects.begin(), effects.end(), same);
      if (place == effects.end()) place = effects.insert(effects.end(), std::vector<RungOf<Rung>>());
      place->push_back({vehicle, &rung});
    }
  }
  std::vector<Summary> list;
  for (const auto& rungs : effects) list.push_back(summary_of(rungs));
  return list;
}

MatchedSummary matched_summary(const std::vector<const MatchedResult*>& results) {
  MatchedSummary sum;
  for (const MatchedResult* result : results) {
    sum.add(*result);
    sum.mask_iou_worst = std::min(sum.mask_iou_worst, result->mask_iou);
  }
  return sum;
}

MatchedSummary matched_summary(const Vehicles& vehicles) {
  std::vector<const MatchedResult*> results;
  for (const VehicleResult* vehicle : vehicles) results.push_back(&vehicle->seen->matched);
  return matched_summary(results);
}

std::vector<CameraSummary> camera_summaries(const Vehicles& vehicles) {
  std::map<std::string, std::vector<const MatchedResult*>> by_name;
  for (const VehicleResult* vehicle : vehicles)
    if (const auto& surround = vehicle->seen->surround)
      for (const CameraResult& seen : surround->cameras) by_name[seen.camera].push_back(&seen.matched);
  std::vector<CameraSummary> cameras;
  for (const auto& [camera, results] : by_name)
    cameras.push_back({camera, static_cast<int>(results.size()), matched_summary(results)});
  return cameras;
}

FullSummary full_summary(const Vehicles& vehicles) {
  FullSummary sum;
  double radiance = 0;
  Errors errors;
  for (const VehicleResult* vehicle : vehicles) {
    const FullResult& full = vehicle->seen->full;
    sum.change.mae += full.mae;
    radiance += full.mean;
    sum.change.ssim += full.ssim;
    sum.change.flip += full.flip;
    sum.seconds += full.seconds;
    errors.add(*vehicle, full.error);
  }
  if (vehicles.empty()) return sum;
  sum.change.relative = radiance > 0 ? sum.change.mae / radiance : 0;
  for (double* total : {&sum.change.mae, &sum.change.ssim, &sum.change.flip, &sum.seconds})
    *total /= static_cast<double>(vehicles.size());
  sum.error = errors.pooled();
  return sum;
}

void add(FooledSummary& sum, const SeenResult& seen) {
  if (!seen.detected) return;
  ++sum.detected_clean;
  sum.hidden_raster += seen.raster.hidden;
  sum.hidden_cycles += seen.cycles.hidden;
  sum.hidden_both += seen.raster.hidden && seen.cycles.hidden;
  sum.fooled_raster += seen.raster.fooled();
  sum.fooled_cycles += seen.cycles.fooled();
}

using nlohmann::json;

/// The figures of a camera's picture, without those of rays.
json camera_figures(const CameraSummary& of) {
  json out = fields_json(of.matched);
  for (const char* key : {"range_error_m", "hit_disagreements", "rays", "returns"}) out.erase(key);
  out.update({{"camera", of.camera}, {"vehicles", of.vehicles}});
  return out;
}

json truth(const std::optional<bool>& known) {
  return known ? json(*known) : json();
}

}  // namespace

std::optional<bool> Verdict::vacuous(Channel channel) const {
  std::optional<bool> vacuous;
  for (const Compared<VerdictControl>& control : controls) {
    if (control.key.channel != channel) continue;
    const bool changed = control.flips > 0 || control.mean_delta_logit >= kMinDeltaLogit;
    vacuous = vacuous.value_or(true) && !changed;
  }
  return vacuous;
}

const Compared<RenderCondition>* Verdict::nearest_to_reality(bool sees) const {
  const RenderCondition wanted{sees ? ConditionLight::cycles : ConditionLight::raster,
                               ConditionReturns::realistic};
  for (const Compared<RenderCondition>& condition : judged().conditions)
    if (condition.key == wanted) return &condition;
  return nullptr;
}

Verdict verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames) {
  Vehicles held_back, all;
  Verdict result;
  for (const VehicleResult& vehicle : vehicles) {
    if (!vehicle.seen) continue;
    const SeenResult& seen = *vehicle.seen;
    const bool tested = test_frames.contains(vehicle.host.frame);
    const std::string split = tested ? "test" : "train";
    result.pairs.push_back({vehicle.name, vehicle.host.frame, split, seen.detected, seen.clean.score,
                            seen.raster.score, seen.hard.score, seen.cycles.score});
    if (!seen.detected) continue;
    all.push_back(&vehicle);
    if (tested) held_back.push_back(&vehicle);
    if (seen.raster.hidden != seen.cycles.hidden) result.flips.push_back(flip_of(vehicle, split));
  }
  result.held_back = group(held_back);
  result.all = group(all);
  result.controls = compared<VerdictControl>(all, &VerdictResults::controls);
  return result;
}

json to_json(const Verdict& verdict) {
  json out = {{"confidence", kConfidence},
              {"of", &verdict.judged() == &verdict.held_back ? "held_back" : "all"},
              {"vacuous",
               {{"image", truth(verdict.vacuous(Channel::image))},
                {"lidar", truth(verdict.vacuous(Channel::lidar))},
                {"bound", kMinDeltaLogit}}}};
  JsonWriter fields;
  visit_named(fields, "held_back", verdict.held_back, "all", verdict.all, "pairs", verdict.pairs, "flips",
              verdict.flips, "arms", verdict.judged().conditions, "controls", verdict.controls);
  out.update(fields.json);
  return out;
}

std::vector<Target> targets_of(const ValidationSummary& summary) {
  const MatchedSummary& matched = summary.matched;
  constexpr double kMaskIou = 0.9999, kError = 1e-4, kRange = 1e-4;  // scene-linear; m
  const auto met = [](int measured, bool reached) {
    return measured > 0 ? std::optional(reached) : std::nullopt;
  };
  std::vector<Target> targets = {
      {"matched.mask_iou", "", kMaskIou, met(matched.mask_either, matched.mask_iou >= kMaskIou)},
      {"matched.mae", "", kError, met(matched.mask_either, matched.mae <= kError)},
      {"matched.hit_disagreements", "", 0, met(matched.rays, matched.hit_disagreements == 0)},
      {"matched.range_error_m", "", kRange, met(matched.returns, matched.range_error <= kRange)}};
  for (std::size_t k = 0; k < summary.cameras.size(); ++k) {
    const MatchedSummary& seen = summary.cameras[k].matched;
    targets.push_back({fmt::format("cameras.{}.mae", k), summary.cameras[k].camera, kError,
                       met(seen.mask_either, seen.mae <= kError)});
  }
  return targets;
}

ValidationSummary summarize_vehicles(const std::vector<VehicleResult>& all,
                                     const std::set<std::string>& test_frames) {
  Vehicles vehicles;
  std::set<std::string> frames;
  ValidationSummary summary;
  for (const VehicleResult& vehicle : all) {
    if (!vehicle.seen) continue;
    vehicles.push_back(&vehicle);
    frames.insert(vehicle.host.frame);
    const int samples = vehicle.seen->samples;
    summary.least_samples = vehicles.size() == 1 ? samples : std::min(summary.least_samples, samples);
    summary.most_samples = std::max(summary.most_samples, samples);
    ++(vehicle.from_box ? summary.rooftops.from_box : summary.rooftops.fitted);
    add(test_frames.contains(vehicle.host.frame) ? summary.attack : summary.attack_train, *vehicle.seen);
  }
  summary.frames = static_cast<int>(frames.size());
  summary.test_frames = static_cast<int>(
      std::count_if(frames.begin(), frames.end(), [&](const auto& f) { return test_frames.contains(f); }));
  summary.vehicles = static_cast<int>(vehicles.size());
  summary.matched = matched_summary(vehicles);
  summary.cameras = camera_summaries(vehicles);
  summary.full = full_summary(vehicles);
  summary.noise = mean(vehicles, [](const auto* vehicle) { return vehicle->seen->full.noise; }).value_or(0);
  summary.ladder = ladder<LightRungSummary>(vehicles, &LadderResult::light);
  summary.lidar_ladder = ladder<LidarRungSummary>(vehicles, &LadderResult::lidar);
  return summary;
}

json to_json(const ValidationSummary& summary) {
  JsonWriter fields;
  visit_named(fields, "frames", summary.frames, "test_frames", summary.test_frames, "vehicles",
              summary.vehicles, "matched", summary.matched, "full", summary.full, "noise", summary.noise,
              "ladder", summary.ladder, "lidar_ladder", summary.lidar_ladder, "attack", summary.attack,
              "attack_train", summary.attack_train);
  fields.derived("rooftops", to_json(summary.rooftops));
  fields.derived("samples_used", json{{"least", summary.least_samples}, {"most", summary.most_samples}});
  if (!summary.cameras.empty()) fields.derived("cameras", list_json(summary.cameras, camera_figures));
  return std::move(fields.json);
}

}  // namespace mirage
