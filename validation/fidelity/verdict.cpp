#include "validation/fidelity/verdict.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "base/clustered_share.h"
#include "base/clusters.h"
#include "detection/reliance.h"

namespace mirage {
namespace {

using nlohmann::json;

struct Variant {
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
  json result(const std::string& name) const {
    return {{"name", name},
            {"vehicles", vehicles},
            {"fn_asr", to_json(hidden.interval())},
            {"fp_asr", to_json(false_positive.interval())},
            {"asr", to_json(fooled.interval())},
            {"mean_score", score / std::max(1, vehicles)}};
  }
};

/// The words that tell a variant from the others, as the file has them: {"light": "raster", …}.
using Names = std::map<std::string, std::string>;

/// A variant that is compared with a first one on the same vehicles.
struct Compared {
  Names names;
  Variant variant;
  ClusteredShare difference;
  int flips = 0;
  double logit = 0, score = 0;  ///< sums of |Δ|

  void add(const std::string& cluster, const OutcomeResult& outcome, const OutcomeResult& first) {
    variant.add(cluster, outcome);
    difference.add(cluster, double(outcome.fooled()) - double(first.fooled()));
    flips += outcome.hidden != first.hidden || outcome.false_positive != first.false_positive;
    logit += std::abs(outcome.logit - first.logit);
    score += std::abs(outcome.score - first.score);
  }
  double mean_delta_logit() const { return logit / variant.vehicles; }
  json result() const {
    json row = variant.result("");
    row.erase("name");
    row.update(names);
    row["difference"] = to_json(difference.signed_interval());
    row["flips"] = flips;
    row["mean_delta_logit"] = mean_delta_logit();
    row["mean_delta_score"] = score / variant.vehicles;
    return row;
  }
};

Names names_of(const ArmResult& arm) {
  return {{"light", arm.light}, {"returns", arm.returns}};
}
Names names_of(const ControlResult& control) {
  return {{"channel", control.channel}, {"control", control.control}};
}

/// The vehicles' arms or controls against the first of their arms, in the order of their coming.
template <class Entry>
std::vector<Compared> compared(const std::vector<const VehicleResult*>& vehicles,
                               std::vector<Entry> ArmsResult::*which) {
  std::vector<Compared> all;
  for (const VehicleResult* vehicle : vehicles) {
    if (!vehicle->seen->arms) continue;
    const ArmsResult& looks = *vehicle->seen->arms;
    for (const Entry& entry : looks.*which) {
      const Names names = names_of(entry);
      auto place = std::find_if(all.begin(), all.end(), [&](const Compared& c) { return c.names == names; });
      if (place == all.end()) place = all.insert(all.end(), Compared{names, {}, {}});
      place->add(cluster_of(vehicle->host.frame, vehicle->track), entry.outcome, looks.arms.at(0).outcome);
    }
  }
  return all;
}

json rows(const std::vector<Compared>& all) {
  auto list = json::array();
  for (const Compared& variant : all) list.push_back(variant.result());
  return list;
}

json vacuous(const std::vector<Compared>& controls, const std::string& channel) {
  bool looked = false, changed = false;
  for (const Compared& control : controls) {
    if (control.names.at("channel") != channel) continue;
    looked = true;
    changed |= control.flips > 0 || control.mean_delta_logit() >= kLeastDeltaLogit;
  }
  return looked ? json(!changed) : json();
}

/// Pearson's; null where one of the two does not vary.
json correlation(const std::vector<std::pair<double, double>>& pairs) {
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  for (const auto& [x, y] : pairs) mx += x, my += y;
  const auto n = static_cast<double>(pairs.size());
  mx /= n, my /= n;
  for (const auto& [x, y] : pairs) {
    xx += (x - mx) * (x - mx);
    yy += (y - my) * (y - my);
    xy += (x - mx) * (y - my);
  }
  if (pairs.size() < 2 || !(xx > 0) || !(yy > 0)) return nullptr;
  return xy / std::sqrt(xx * yy);
}

json group(const std::vector<const VehicleResult*>& vehicles) {
  std::vector<std::string> order{"soft", "hard"};
  std::map<std::string, Variant> variants;
  std::set<std::string> frames;
  Clusters clusters;
  std::vector<std::pair<double, double>> scores;
  ClusteredShare hidden, false_positive, fooled;
  int agree = 0;
  for (const VehicleResult* vehicle : vehicles) {
    const SeenResult& seen = *vehicle->seen;
    const std::string cluster = cluster_of(vehicle->host.frame, vehicle->track);
    frames.insert(vehicle->host.frame);
    clusters.add(vehicle->host.frame, vehicle->track);
    const OutcomeResult &soft = seen.raster, &cycles = seen.cycles;
    variants["soft"].add(cluster, soft);
    variants["hard"].add(cluster, seen.hard);
    if (seen.ladder)
      for (const LightRungResult& rung : seen.ladder->light) {
        const std::string& effect = rung.effect;
        if (!rung.outcome || effect == "soft" || effect == "hard" || effect == "full") continue;
        if (!variants.contains(effect)) order.push_back(effect);
        variants[effect].add(cluster, *rung.outcome);
      }
    variants["cycles"].add(cluster, cycles);
    hidden.add(cluster, double(soft.hidden) - double(cycles.hidden));
    false_positive.add(cluster, double(soft.false_positive) - double(cycles.false_positive));
    fooled.add(cluster, double(soft.fooled()) - double(cycles.fooled()));
    agree += soft.hidden == cycles.hidden && soft.false_positive == cycles.false_positive;
    scores.emplace_back(soft.score, cycles.score);
  }
  order.push_back("cycles");
  json result = {{"frames", frames.size()},
                 {"vehicles", vehicles.size()},
                 {"clusters", to_json(clusters.count())},
                 {"variants", json::array()},
                 {"arms", rows(compared(vehicles, &ArmsResult::arms))}};
  for (const std::string& name : order)
    if (const auto variant = variants.find(name); variant != variants.end())
      result["variants"].push_back(variant->second.result(name));
  const double n = std::max<double>(1, static_cast<double>(vehicles.size()));
  double score_difference = 0;
  for (const auto& [soft, cycles] : scores) score_difference += std::abs(soft - cycles);
  result["difference"] = {{"fn_asr", to_json(hidden.signed_interval())},
                          {"fp_asr", to_json(false_positive.signed_interval())},
                          {"asr", to_json(fooled.signed_interval())}};
  result["agree"] = agree / n;
  result["score_correlation"] = correlation(scores);
  result["score_mean_difference"] = score_difference / n;
  return result;
}

json flip_of(const VehicleResult& vehicle, const std::string& split) {
  const SeenResult& seen = *vehicle.seen;
  const auto word = [](const OutcomeResult& outcome) { return outcome.hidden ? "hidden" : "found"; };
  json pictures = json::object();
  for (const char* name : {"attacked", "cycles", "raster_crop", "cycles_crop", "difference"})
    if (const auto file = seen.pictures.find(name); file != seen.pictures.end())
      pictures[name] = file->second;
  return {{"name", vehicle.name},
          {"frame", vehicle.host.frame},
          {"split", split},
          {"range", seen.range},
          {"from", word(seen.raster)},
          {"to", word(seen.cycles)},
          {"soft_iou", seen.raster.iou},
          {"soft_score", seen.raster.score},
          {"cycles_iou", seen.cycles.iou},
          {"cycles_score", seen.cycles.score},
          {"pictures", pictures}};
}

}  // namespace

json verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames) {
  std::vector<const VehicleResult*> held_back, all;
  auto pairs = json::array(), flips = json::array();
  for (const VehicleResult& vehicle : vehicles) {
    if (!vehicle.seen) continue;
    const SeenResult& seen = *vehicle.seen;
    const bool tested = test_frames.contains(vehicle.host.frame);
    const std::string split = tested ? "test" : "train";
    pairs.push_back({{"name", vehicle.name},
                     {"frame", vehicle.host.frame},
                     {"split", split},
                     {"detected", seen.detected},
                     {"clean", seen.clean_score},
                     {"soft", seen.raster.score},
                     {"hard", seen.hard.score},
                     {"cycles", seen.cycles.score}});
    if (!seen.detected) continue;
    all.push_back(&vehicle);
    if (tested) held_back.push_back(&vehicle);
    if (seen.raster.hidden != seen.cycles.hidden) flips.push_back(flip_of(vehicle, split));
  }
  json result = {{"confidence", BootstrapSettings().confidence},
                 {"held_back", group(held_back)},
                 {"all", group(all)},
                 {"pairs", pairs},
                 {"flips", flips}};
  const std::string of = held_back.empty() ? "all" : "held_back";
  const std::vector<Compared> controls = compared(all, &ArmsResult::controls);
  result["of"] = of;
  result["arms"] = result.at(of).at("arms");
  result["controls"] = rows(controls);
  result["vacuous"] = {{"image", vacuous(controls, "image")},
                       {"lidar", vacuous(controls, "lidar")},
                       {"bound", kLeastDeltaLogit}};
  return result;
}

}  // namespace mirage
