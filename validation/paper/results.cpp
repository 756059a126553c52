#include "validation/paper/results.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <tuple>

#include "attack/baseline.h"
#include "base/error.h"
#include "base/files.h"

namespace mirage::paper {
namespace {

Outcome read_outcome(const nlohmann::json& item) {
  Outcome outcome;
  outcome.frame = item.at("frame");
  outcome.label = item.at("label");
  outcome.mesh = item.value("mesh", 0);
  outcome.track = item.value("track", -1);
  outcome.range = item.at("range");
  outcome.clean_iou = item.at("clean_iou");
  outcome.attacked_iou = item.at("attacked_iou");
  for (const auto& [key, distance] : {std::pair("clean_distance", &outcome.clean_distance),
                                      std::pair("attacked_distance", &outcome.attacked_distance)})
    if (item.contains(key) && item.at(key).is_number()) *distance = item.at(key);
  outcome.detected = item.at("detected");
  outcome.hidden = item.at("hidden");
  outcome.false_positive = item.at("false_positive");
  return outcome;
}

std::shared_ptr<Outcomes> read_outcomes(const nlohmann::json& item, const std::string& data) {
  auto outcomes = std::make_shared<Outcomes>();
  outcomes->data = data;
  outcomes->vehicles = item.at("vehicles");
  for (const auto& host : item.at("outcomes")) {
    outcomes->hosts.push_back(read_outcome(host));
    outcomes->meshes = std::max(outcomes->meshes, outcomes->hosts.back().mesh + 1);
  }
  std::map<std::tuple<std::string, int, int>, std::vector<double>> distances;
  for (const auto& box : item.at("false_positives").at("list"))
    if (!box.contains("distance_from_host_px"))  // in the picture's plane there are no metres
      distances[{box.at("frame"), box.at("label"), box.at("mesh")}].push_back(box.at("distance_from_host"));
  for (Outcome& host : outcomes->hosts)
    if (const auto own = distances.find({host.frame, host.label, host.mesh}); own != distances.end())
      host.distances = own->second;
  return outcomes;
}

using Sums = std::map<CrossingName, ClusterSums>;

Sums sums_of(const Outcomes& outcomes, const Which& counts, const Which& which) {
  Sums all;
  for (const Outcome& host : outcomes.hosts) {
    if (!counts(host)) continue;
    ClusterSums& sums = all[host.crossing()];
    sums.numerator += which(host);
    sums.denominator += 1;
  }
  return all;
}

/// Hosts detected clean, each once whatever the meshes and runs.
int count_vehicles(const std::vector<Outcome>& hosts) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : hosts)
    if (host.detected) names.insert({host.frame, host.label});
  return static_cast<int>(names.size());
}

bool is_detected(const Outcome& host) {
  return host.detected;
}

/// IoU 0 asks for any overlap at all.
bool found(const Outcome& host, double iou, bool clean) {
  const double own = clean ? host.clean_iou : host.attacked_iou;
  return own > 0 && own >= iou;
}

constexpr int kSteps = 20;

}  // namespace

int Outcomes::frames() const {
  std::set<std::string> names;
  for (const Outcome& host : hosts) names.insert(host.frame);
  return static_cast<int>(names.size());
}

std::string Outcomes::note() const {
  return reliance.is_object() ? reliance.at("note").get<std::string>() : "";
}

int Outcomes::clusters() const {
  std::set<std::string> names;
  for (const Outcome& host : hosts) names.insert(host.cluster());
  return static_cast<int>(names.size());
}

bool is_hidden(const Outcome& host) {
  return host.hidden;
}
bool is_false_positive(const Outcome& host) {
  return host.false_positive;
}
bool is_fooled(const Outcome& host) {
  return host.fooled();
}

Judged read_evaluation(const std::filesystem::path& file, const std::string& data) {
  const nlohmann::json json = read_json(file);
  try {
    const auto learned = read_outcomes(json, data);
    learned->reliance = json.value("reliance", nlohmann::json());
    learned->name = "learned mesh";
    const auto other = [&](const char* key, Baseline kind) -> std::shared_ptr<const Outcomes> {
      if (!json.contains(key) || !json.at(key).is_object() || !json.at(key).contains("outcomes"))
        return nullptr;
      const auto outcomes = read_outcomes(json.at(key), data);
      outcomes->reliance = learned->reliance;
      outcomes->name = describe(kind);
      return outcomes;
    };
    return {learned, other("random", Baseline::start), other("sized", Baseline::sized),
            other("cuboid", Baseline::cuboid)};
  } catch (const nlohmann::json::exception& error) {
    throw InputError(file.string(), "", error.what(), "delete the folder and run the same command again");
  }
}

Judged pooled(const std::vector<Judged>& runs) {
  const auto all = [&](std::shared_ptr<const Outcomes> Judged::*part) -> std::shared_ptr<const Outcomes> {
    auto pool = std::make_shared<Outcomes>();
    for (std::size_t r = 0; r < runs.size(); ++r) {
      const Outcomes* outcomes = (runs[r].*part).get();
      if (!outcomes) return nullptr;
      if (r == 0) *pool = *outcomes, pool->hosts.clear();
      pool->meshes = std::max(pool->meshes, outcomes->meshes);
      for (Outcome host : outcomes->hosts) {
        host.run = static_cast<int>(r);
        pool->hosts.push_back(std::move(host));
      }
    }
    pool->runs = static_cast<int>(runs.size());
    pool->vehicles = count_vehicles(pool->hosts);
    return pool;
  };
  if (runs.size() == 1) return runs.front();
  return {all(&Judged::learned), all(&Judged::random), all(&Judged::sized), all(&Judged::cuboid)};
}

Interval success(const Outcomes& outcomes, const Which& which) {
  return crossed_interval(sums_of(outcomes, is_detected, which));
}

static Sums hiding_sums(const Outcomes& outcomes, const HidingRule& rule) {
  return sums_of(
      outcomes, [&](const Outcome& host) { return rule.finds(host.clean_iou, host.clean_distance); },
      [&](const Outcome& host) { return !rule.finds(host.attacked_iou, host.attacked_distance); });
}

std::optional<Interval> hiding(const Outcomes& outcomes, const HidingRule& rule) {
  const auto has_metres = [](const Outcome& host) { return std::isfinite(host.clean_distance); };
  if (rule.distance > 0 && std::none_of(outcomes.hosts.begin(), outcomes.hosts.end(), has_metres))
    return std::nullopt;
  return crossed_interval(hiding_sums(outcomes, rule));
}

int found_clean(const Outcomes& outcomes, const HidingRule& rule) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : outcomes.hosts)
    if (rule.finds(host.clean_iou, host.clean_distance)) names.insert({host.frame, host.label});
  return static_cast<int>(names.size());
}

Interval vanished(const Outcomes& outcomes) {
  return *hiding(outcomes, kHidingRules.front());
}

Outcomes shared_hosts(const Outcomes& a, const Outcomes& b) {
  std::set<std::tuple<std::string, int, int>> names;
  for (const Outcome& host : b.hosts) names.insert({host.frame, host.label, host.run});
  return part(a, [&](const Outcome& host) { return names.contains({host.frame, host.label, host.run}); });
}

Outcomes part(const Outcomes& outcomes, const Which& keep) {
  Outcomes kept = outcomes;
  std::erase_if(kept.hosts, [&](const Outcome& host) { return !keep(host); });
  kept.vehicles = count_vehicles(kept.hosts);
  return kept;
}

static Interval paired_difference(const Outcomes& a, const Outcomes& b, const Which& counts,
                                  const Which& which) {
  std::map<CrossingName, PairedSums> both;
  for (const auto& [name, sums] : sums_of(shared_hosts(a, b), counts, which)) both[name].a = sums;
  for (const auto& [name, sums] : sums_of(shared_hosts(b, a), counts, which)) both[name].b = sums;
  return crossed_difference(both);
}

Interval hiding_difference(const Outcomes& a, const Outcomes& b, const HidingRule& rule) {
  std::map<CrossingName, PairedSums> both;
  for (const auto& [name, sums] : hiding_sums(shared_hosts(a, b), rule)) both[name].a = sums;
  for (const auto& [name, sums] : hiding_sums(shared_hosts(b, a), rule)) both[name].b = sums;
  return crossed_difference(both);
}

Interval net_difference(const NetOf& a, const NetOf& b, const HidingRule& rule) {
  const std::array<const Outcomes*, 4> of = {a.learned, a.control, b.learned, b.control};
  std::map<CrossingName, std::array<ClusterSums, 4>> by_name;
  for (std::size_t k = 0; k < of.size(); ++k) {
    Outcomes shared = *of[k];
    for (const Outcomes* other : of) shared = shared_hosts(shared, *other);
    for (const auto& [name, sums] : hiding_sums(shared, rule)) by_name[name][k] = sums;
  }
  std::vector<std::array<ClusterSums, 4>> items;
  for (const auto& [name, sums] : by_name) items.push_back(sums);
  return crossed_statistic(crossings(by_name), [&](std::span<const int> drawn) {
    std::array<double, 4> share{};
    for (std::size_t k = 0; k < share.size(); ++k) {
      ClusterSums sums;
      for (std::size_t i = 0; i < items.size(); ++i) {
        sums.numerator += drawn[i] * items[i][k].numerator;
        sums.denominator += drawn[i] * items[i][k].denominator;
      }
      share[k] = sums.numerator / sums.denominator;  // NaN without any
    }
    return share[0] - share[1] - share[2] + share[3];
  });
}

Interval success_difference(const Outcomes& a, const Outcomes& b, const Which& which) {
  return paired_difference(a, b, is_detected, which);
}

Interval clean_recall_difference(const Outcomes& a, const Outcomes& b, double iou) {
  return paired_difference(
      a, b, [](const Outcome&) { return true; }, [&](const Outcome& host) { return found(host, iou, true); });
}

Interval recall(const Outcomes& outcomes, double iou, bool clean) {
  return crossed_interval(sums_of(
      outcomes, [](const Outcome&) { return true; },
      [&](const Outcome& host) { return found(host, iou, clean); }));
}

Interval mean_recall(const Outcomes& outcomes, bool clean) {
  Sums all;
  for (const Outcome& host : outcomes.hosts) {
    ClusterSums& sums = all[host.crossing()];
    for (int step = 0; step <= kSteps; ++step) {
      sums.numerator += found(host, step / double(kSteps), clean);
      sums.denominator += 1;
    }
  }
  return crossed_interval(all);
}

nlohmann::json recall_curve(const Outcomes& outcomes, bool clean) {
  nlohmann::json curve;
  for (int step = 0; step <= kSteps; ++step) {
    const double iou = step / double(kSteps);
    const Interval at = recall(outcomes, iou, clean);
    curve["iou"].push_back(iou);
    curve["recall"].push_back(at.value);
    curve["low"].push_back(at.low);
    curve["high"].push_back(at.high);
  }
  return curve;
}

}  // namespace mirage::paper
