#include "validation/fidelity/verdict.h"

#include <cmath>
#include <map>

#include "base/bootstrap.h"
#include "base/clusters.h"
#include "detection/reliance.h"

namespace mirage {
namespace {

using nlohmann::json;

bool is_fooled(const json& outcome) {
  return outcome.at("hidden").get<bool>() || outcome.at("false_positive").get<bool>();
}

/// A share's numerators and denominators by cluster.
class Share {
 public:
  void add(const std::string& cluster, double value) {
    ClusterSums& sums = clusters_[cluster];
    sums.numerator += value;
    sums.denominator += 1;
  }
  Interval interval() const {
    std::vector<ClusterSums> clusters;
    for (const auto& [name, sums] : clusters_) clusters.push_back(sums);
    return bootstrap_interval(clusters);
  }
  /// Of a difference of shares: without any it may go either way.
  Interval signed_interval() const {
    Interval result = interval();
    if (result.value == 0 && result.low == 0) result.low = -result.high;
    return result;
  }

 private:
  std::map<std::string, ClusterSums> clusters_;
};

struct Variant {
  int vehicles = 0;
  double score = 0;
  Share hidden, false_positive, fooled;

  void add(const std::string& cluster, const json& outcome) {
    ++vehicles;
    score += outcome.at("score").get<double>();
    hidden.add(cluster, outcome.at("hidden").get<bool>());
    false_positive.add(cluster, outcome.at("false_positive").get<bool>());
    fooled.add(cluster, is_fooled(outcome));
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

/// Variants that are compared with a first one on the same vehicles, in the order of their coming.
class Compared {
 public:
  /// `names`: what tells this outcome's variant.
  void add(const std::string& cluster, const json& outcome, const json& first,
           const std::vector<std::string>& names) {
    std::vector<std::string> values;
    for (const std::string& name : names) values.push_back(outcome.at(name));
    auto [place, added] = entries_.try_emplace(values);
    Entry& entry = place->second;
    if (added) {
      order_.push_back(values);
      for (const std::string& name : names) entry.names[name] = outcome.at(name);
    }
    entry.variant.add(cluster, outcome);
    entry.difference.add(cluster, double(is_fooled(outcome)) - double(is_fooled(first)));
    entry.flips += outcome.at("hidden") != first.at("hidden") ||
                   outcome.at("false_positive") != first.at("false_positive");
    entry.logit += std::abs(outcome.at("logit").get<double>() - first.at("logit").get<double>());
    entry.score += std::abs(outcome.at("score").get<double>() - first.at("score").get<double>());
  }
  json result() const {
    auto list = json::array();
    for (const auto& values : order_) {
      const Entry& entry = entries_.at(values);
      json row = entry.variant.result("");
      row.erase("name");
      row.update(entry.names);
      row["difference"] = to_json(entry.difference.signed_interval());
      row["flips"] = entry.flips;
      row["mean_delta_logit"] = entry.logit / entry.variant.vehicles;
      row["mean_delta_score"] = entry.score / entry.variant.vehicles;
      list.push_back(std::move(row));
    }
    return list;
  }

 private:
  struct Entry {
    json names = json::object();
    Variant variant;
    Share difference;
    int flips = 0;
    double logit = 0, score = 0;
  };
  std::map<std::vector<std::string>, Entry> entries_;
  std::vector<std::vector<std::string>> order_;
};

std::string own_cluster(const json& vehicle) {
  return cluster_of(vehicle.at("frame").get<std::string>(), vehicle.value("track", -1));
}

/// The vehicles' outcomes under `key`, against the first of their arms.
json compared(const std::vector<const json*>& vehicles, const char* key,
              const std::vector<std::string>& names) {
  Compared all;
  for (const json* vehicle : vehicles)
    if (vehicle->contains("arms"))
      for (const json& outcome : vehicle->at(key))
        all.add(own_cluster(*vehicle), outcome, vehicle->at("arms").at(0), names);
  return all.result();
}

json vacuous(const json& controls, const std::string& channel) {
  bool looked = false, changed = false;
  for (const json& control : controls) {
    if (control.at("channel") != channel) continue;
    looked = true;
    changed |= control.at("flips").get<int>() > 0 ||
               control.at("mean_delta_logit").get<double>() >= kLeastDeltaLogit;
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

json group(const std::vector<const json*>& vehicles) {
  std::vector<std::string> order{"soft", "hard"};
  std::map<std::string, Variant> variants;
  std::set<std::string> frames;
  Clusters clusters;
  std::vector<std::pair<double, double>> scores;
  Share hidden, false_positive, fooled;
  int agree = 0;
  for (const json* vehicle : vehicles) {
    const auto frame = vehicle->at("frame").get<std::string>();
    const int track = vehicle->value("track", -1);
    const std::string cluster = cluster_of(frame, track);
    frames.insert(frame);
    clusters.add(frame, track);
    const json &soft = vehicle->at("raster"), &cycles = vehicle->at("cycles");
    variants["soft"].add(cluster, soft);
    if (vehicle->contains("hard")) variants["hard"].add(cluster, vehicle->at("hard"));
    for (const json& rung : vehicle->value("ladder", json::array())) {
      const auto effect = rung.at("effect").get<std::string>();
      if (!rung.contains("score") || effect == "soft" || effect == "hard" || effect == "full") continue;
      if (!variants.contains(effect)) order.push_back(effect);
      variants[effect].add(cluster, rung);
    }
    variants["cycles"].add(cluster, cycles);
    const auto difference = [&](const char* key) {
      return double(soft.at(key).get<bool>()) - double(cycles.at(key).get<bool>());
    };
    hidden.add(cluster, difference("hidden"));
    false_positive.add(cluster, difference("false_positive"));
    fooled.add(cluster, double(is_fooled(soft)) - double(is_fooled(cycles)));
    agree +=
        soft.at("hidden") == cycles.at("hidden") && soft.at("false_positive") == cycles.at("false_positive");
    scores.emplace_back(soft.at("score").get<double>(), cycles.at("score").get<double>());
  }
  order.push_back("cycles");
  json result = {{"frames", frames.size()},
                 {"vehicles", vehicles.size()},
                 {"clusters", to_json(clusters.count())},
                 {"variants", json::array()},
                 {"arms", compared(vehicles, "arms", {"light", "returns"})}};
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

json flip_of(const json& vehicle, const std::string& split) {
  const auto word = [](const json& outcome) { return outcome.at("hidden").get<bool>() ? "hidden" : "found"; };
  const json &soft = vehicle.at("raster"), &cycles = vehicle.at("cycles");
  json pictures = json::object();
  for (const char* name : {"attacked", "cycles", "raster_crop", "cycles_crop", "difference"})
    if (vehicle.value("pictures", json::object()).contains(name))
      pictures[name] = vehicle.at("pictures").at(name);
  return {{"name", vehicle.at("name")},
          {"frame", vehicle.at("frame")},
          {"split", split},
          {"range", vehicle.at("range")},
          {"from", word(soft)},
          {"to", word(cycles)},
          {"soft_iou", soft.at("iou")},
          {"soft_score", soft.at("score")},
          {"cycles_iou", cycles.at("iou")},
          {"cycles_score", cycles.at("score")},
          {"pictures", pictures}};
}

}  // namespace

json verdict(const std::vector<json>& vehicles, const std::set<std::string>& test_frames) {
  std::vector<const json*> held_back, all;
  auto pairs = json::array(), flips = json::array();
  for (const json& vehicle : vehicles) {
    if (!vehicle.contains("cycles")) continue;
    const bool tested = test_frames.contains(vehicle.at("frame").get<std::string>());
    const std::string split = tested ? "test" : "train";
    const bool detected = vehicle.at("detected");
    const auto score = [&](const char* key) {
      return vehicle.contains(key) ? vehicle.at(key).at("score") : json();
    };
    pairs.push_back({{"name", vehicle.at("name")},
                     {"frame", vehicle.at("frame")},
                     {"split", split},
                     {"detected", detected},
                     {"clean", score("clean")},
                     {"soft", score("raster")},
                     {"hard", score("hard")},
                     {"cycles", score("cycles")}});
    if (!detected) continue;
    all.push_back(&vehicle);
    if (tested) held_back.push_back(&vehicle);
    if (vehicle.at("raster").at("hidden") != vehicle.at("cycles").at("hidden"))
      flips.push_back(flip_of(vehicle, split));
  }
  json result = {{"confidence", BootstrapSettings().confidence},
                 {"held_back", group(held_back)},
                 {"all", group(all)},
                 {"pairs", pairs},
                 {"flips", flips}};
  const std::string of = held_back.empty() ? "all" : "held_back";
  result["of"] = of;
  result["arms"] = result.at(of).at("arms");
  result["controls"] = compared(all, "controls", {"channel", "control"});
  result["vacuous"] = {{"image", vacuous(result["controls"], "image")},
                       {"lidar", vacuous(result["controls"], "lidar")},
                       {"bound", kLeastDeltaLogit}};
  return result;
}

}  // namespace mirage
