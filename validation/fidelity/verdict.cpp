#include "validation/fidelity/verdict.h"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "base/field_json.h"
#include "base/intervals.h"
#include "detection/reliance.h"

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

/// The vehicles' arms or controls against the first of their arms, in the order of their coming.
template <class Look, class Entry>
std::vector<Compared<Look>> compared(const Vehicles& vehicles, std::vector<Entry> ArmsResult::*which) {
  std::vector<std::pair<Look, Paired>> all;
  for (const VehicleResult* vehicle : vehicles) {
    if (!vehicle->seen->arms) continue;
    const ArmsResult& looks = *vehicle->seen->arms;
    for (const auto& [look, outcome] : looks.*which) {
      const Look& wanted = look;
      auto place = std::find_if(all.begin(), all.end(), [&](const auto& of) { return of.first == wanted; });
      if (place == all.end()) place = all.insert(all.end(), {look, Paired()});
      place->second.add(own_cluster(*vehicle), outcome, looks.arms.at(0).outcome);
    }
  }
  constexpr bool kArms = std::is_same_v<Look, VerdictArm>;  // whose first is not compared with itself
  std::vector<Compared<Look>> list;
  for (const auto& [look, paired] : all) {
    const double n = paired.tally.vehicles;
    const std::optional<Interval> difference =
        kArms && list.empty() ? std::nullopt : std::optional(paired.difference().asr);
    list.push_back(
        {paired.tally.success(), look, difference, paired.flips, paired.logit / n, paired.score / n});
  }
  return list;
}

/// Pearson's; none where one of the two does not vary.
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
          compared<VerdictArm>(vehicles, &ArmsResult::arms),
          cycles.difference(),
          (count - cycles.flips) / n,
          correlation(scores),
          cycles.score / n};
}

VerdictFlip flip_of(const VehicleResult& vehicle, bool held_back) {
  const SeenResult& seen = *vehicle.seen;
  VerdictFlip flip{vehicle.name, vehicle.host.frame, held_back, seen.range, seen.raster, seen.cycles, {}};
  for (const char* name : {"attacked", "cycles", "raster_crop", "cycles_crop", "difference"})
    if (const auto file = seen.pictures.find(name); file != seen.pictures.end()) flip.pictures.insert(*file);
  return flip;
}

}  // namespace

std::optional<bool> Verdict::vacuous(Channel channel) const {
  std::optional<bool> vacuous;
  for (const Compared<VerdictControl>& control : controls) {
    if (control.look.channel != channel) continue;
    const bool changed = control.flips > 0 || control.mean_delta_logit >= kLeastDeltaLogit;
    vacuous = vacuous.value_or(true) && !changed;
  }
  return vacuous;
}

const Compared<VerdictArm>* Verdict::nearest_to_reality(bool sees) const {
  const VerdictArm wanted{sees ? ArmLight::cycles : ArmLight::raster, ArmReturns::realistic};
  for (const Compared<VerdictArm>& arm : judged().arms)
    if (arm.look == wanted) return &arm;
  return nullptr;
}

Verdict verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames) {
  Vehicles held_back, all;
  Verdict result;
  for (const VehicleResult& vehicle : vehicles) {
    if (!vehicle.seen) continue;
    const SeenResult& seen = *vehicle.seen;
    const bool tested = test_frames.contains(vehicle.host.frame);
    result.pairs.push_back({vehicle.name, vehicle.host.frame, tested, seen.detected, seen.clean.score,
                            seen.raster.score, seen.hard.score, seen.cycles.score});
    if (!seen.detected) continue;
    all.push_back(&vehicle);
    if (tested) held_back.push_back(&vehicle);
    if (seen.raster.hidden != seen.cycles.hidden) result.flips.push_back(flip_of(vehicle, tested));
  }
  result.held_back = group(held_back);
  result.all = group(all);
  result.controls = compared<VerdictControl>(all, &ArmsResult::controls);
  return result;
}

// The verdict as result.json has it.

namespace {

using nlohmann::json;

json share_figures(const SuccessShares& shares) {
  return {
      {"fn_asr", to_json(shares.fn_asr)}, {"fp_asr", to_json(shares.fp_asr)}, {"asr", to_json(shares.asr)}};
}

json success_figures(const Success& success) {
  json out = share_figures(success);
  out.update({{"vehicles", success.vehicles}, {"mean_score", success.mean_score}});
  return out;
}

template <class Look>
json compared_figures(const std::vector<Compared<Look>>& all) {
  return list_json(all, [](const Compared<Look>& entry) {
    json out = success_figures(entry);
    out.update(fields_json(entry.look));
    if (entry.difference)
      out.update({{"difference", to_json(*entry.difference)}, {"told", to_string(told(*entry.difference))}});
    out.update({{"flips", entry.flips},
                {"mean_delta_logit", entry.mean_delta_logit},
                {"mean_delta_score", entry.mean_delta_score}});
    return out;
  });
}

json group_figures(const VerdictGroup& group) {
  auto variants = list_json(group.variants, [](const VerdictVariant& variant) {
    json out = success_figures(variant);
    out["name"] = variant.name;
    return out;
  });
  return {{"frames", group.frames},
          {"vehicles", group.vehicles},
          {"clusters", to_json(group.clusters)},
          {"variants", std::move(variants)},
          {"arms", compared_figures(group.arms)},
          {"difference", share_figures(group.difference)},
          {"told", to_string(told(group.difference.asr))},
          {"agree", group.agree},
          {"score_correlation", group.score_correlation ? json(*group.score_correlation) : json()},
          {"score_mean_difference", group.score_mean_difference}};
}

const char* split(bool held_back) {
  return held_back ? "test" : "train";
}

json pair_figures(const ScorePair& pair) {
  return {{"name", pair.name},         {"frame", pair.frame},  {"split", split(pair.held_back)},
          {"detected", pair.detected}, {"clean", pair.clean},  {"soft", pair.soft},
          {"hard", pair.hard},         {"cycles", pair.cycles}};
}

json flip_figures(const VerdictFlip& flip) {
  const auto word = [](const OutcomeResult& outcome) { return outcome.hidden ? "hidden" : "found"; };
  return {{"name", flip.name},
          {"frame", flip.frame},
          {"split", split(flip.held_back)},
          {"range", flip.range},
          {"from", word(flip.soft)},
          {"to", word(flip.cycles)},
          {"soft_iou", flip.soft.iou},
          {"soft_score", flip.soft.score},
          {"cycles_iou", flip.cycles.iou},
          {"cycles_score", flip.cycles.score},
          {"pictures", flip.pictures}};
}

json truth(const std::optional<bool>& known) {
  return known ? json(*known) : json();
}

}  // namespace

json to_json(const Verdict& verdict) {
  return {{"confidence", kConfidence},
          {"held_back", group_figures(verdict.held_back)},
          {"all", group_figures(verdict.all)},
          {"pairs", list_json(verdict.pairs, pair_figures)},
          {"flips", list_json(verdict.flips, flip_figures)},
          {"of", &verdict.judged() == &verdict.held_back ? "held_back" : "all"},
          {"arms", compared_figures(verdict.judged().arms)},
          {"controls", compared_figures(verdict.controls)},
          {"vacuous",
           {{"image", truth(verdict.vacuous(Channel::image))},
            {"lidar", truth(verdict.vacuous(Channel::lidar))},
            {"bound", kLeastDeltaLogit}}}};
}

}  // namespace mirage
