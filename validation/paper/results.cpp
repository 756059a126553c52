#include "validation/paper/results.h"

#include <algorithm>
#include <set>
#include <tuple>

#include "attack/baseline.h"
#include "attack/hiding.h"
#include "base/error.h"
#include "base/files.h"

namespace mirage::paper {
namespace {

Outcome read_outcome(const nlohmann::json& item) {
  Outcome one;
  one.frame = item.at("frame");
  one.label = item.at("label");
  one.mesh = item.value("mesh", 0);
  one.track = item.value("track", -1);
  one.range = item.at("range");
  one.clean_iou = item.at("clean_iou");
  one.attacked_iou = item.at("attacked_iou");
  one.detected = item.at("detected");
  one.hidden = item.at("hidden");
  one.false_positive = item.at("false_positive");
  return one;
}

std::shared_ptr<Outcomes> read_outcomes(const nlohmann::json& item, const std::string& data) {
  auto made = std::make_shared<Outcomes>();
  made->data = data;
  made->vehicles = item.at("vehicles");
  for (const auto& host : item.at("outcomes")) {
    made->hosts.push_back(read_outcome(host));
    made->meshes = std::max(made->meshes, made->hosts.back().mesh + 1);
  }
  std::map<std::tuple<std::string, int, int>, std::vector<double>> distances;
  for (const auto& box : item.at("false_positives").at("list"))
    distances[{box.at("frame"), box.at("label"), box.at("mesh")}].push_back(box.at("distance_from_host"));
  for (Outcome& host : made->hosts)
    if (const auto found = distances.find({host.frame, host.label, host.mesh}); found != distances.end())
      host.distances = found->second;
  return made;
}

using ByCluster = std::map<std::string, ClusterSums>;

ByCluster by_cluster(const Outcomes& outcomes, const Which& counts, const Which& which) {
  ByCluster clusters;
  for (const Outcome& host : outcomes.hosts) {
    if (!counts(host)) continue;
    ClusterSums& sums = clusters[host.cluster()];
    sums.numerator += which(host);
    sums.denominator += 1;
  }
  return clusters;
}

bool is_detected(const Outcome& host) {
  return host.detected;
}

Interval share(const ByCluster& clusters) {
  std::vector<ClusterSums> list;
  for (const auto& [name, sums] : clusters) list.push_back(sums);
  return bootstrap_interval(list);
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
      const auto made = read_outcomes(json.at(key), data);
      made->reliance = learned->reliance;
      made->name = describe(kind);
      return made;
    };
    return {learned, other("random", Baseline::start), other("sized", Baseline::sized)};
  } catch (const nlohmann::json::exception& error) {
    throw InputError(file.string(), "", error.what(), "delete the folder and run the same command again");
  }
}

Interval success(const Outcomes& outcomes, const Which& which) {
  return share(by_cluster(outcomes, is_detected, which));
}

Interval vanished(const Outcomes& outcomes) {
  const double least = kHidingRules.front().iou;
  return share(by_cluster(
      outcomes, [&](const Outcome& host) { return host.clean_iou > least; },
      [&](const Outcome& host) { return !(host.attacked_iou > least); }));
}

Outcomes shared_hosts(const Outcomes& a, const Outcomes& b) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : b.hosts) names.insert({host.frame, host.label});
  Outcomes kept{a.name, a.data, {}, a.meshes, 0};
  for (const Outcome& host : a.hosts) {
    if (!names.contains({host.frame, host.label})) continue;
    kept.hosts.push_back(host);
    kept.vehicles += host.detected && host.mesh == 0;
  }
  return kept;
}

static Interval paired_difference(const Outcomes& a, const Outcomes& b, const Which& counts,
                                  const Which& which) {
  std::map<std::string, PairedSums> clusters;
  for (const auto& [name, sums] : by_cluster(shared_hosts(a, b), counts, which)) clusters[name].a = sums;
  for (const auto& [name, sums] : by_cluster(shared_hosts(b, a), counts, which)) clusters[name].b = sums;
  std::vector<PairedSums> list;
  for (const auto& [name, sums] : clusters) list.push_back(sums);
  return bootstrap_difference(list);
}

Interval success_difference(const Outcomes& a, const Outcomes& b, const Which& which) {
  return paired_difference(a, b, is_detected, which);
}

Interval clean_recall_difference(const Outcomes& a, const Outcomes& b, double iou) {
  return paired_difference(
      a, b, [](const Outcome&) { return true; }, [&](const Outcome& host) { return found(host, iou, true); });
}

Interval recall(const Outcomes& outcomes, double iou, bool clean) {
  return share(by_cluster(
      outcomes, [](const Outcome&) { return true; },
      [&](const Outcome& host) { return found(host, iou, clean); }));
}

Interval mean_recall(const Outcomes& outcomes, bool clean) {
  ByCluster clusters;
  for (const Outcome& host : outcomes.hosts) {
    ClusterSums& sums = clusters[host.cluster()];
    for (int step = 0; step <= kSteps; ++step) {
      sums.numerator += found(host, step / double(kSteps), clean);
      sums.denominator += 1;
    }
  }
  return share(clusters);
}

nlohmann::json recall_curve(const Outcomes& outcomes, bool clean) {
  std::map<std::string, std::vector<double>> clusters;  // counts at each step, then all hosts
  for (const Outcome& host : outcomes.hosts) {
    auto& counts = clusters[host.cluster()];
    counts.resize(kSteps + 2);
    for (int step = 0; step <= kSteps; ++step)
      counts[static_cast<std::size_t>(step)] += found(host, step / double(kSteps), clean);
    counts.back() += 1;
  }
  std::vector<double> denominators;
  std::vector<std::vector<double>> numerators(kSteps + 1);
  for (const auto& [name, counts] : clusters) {
    for (std::size_t step = 0; step <= kSteps; ++step) numerators[step].push_back(counts[step]);
    denominators.push_back(counts.back());
  }
  nlohmann::json curve;
  int step = 0;
  for (const Interval& at : bootstrap_intervals(denominators, numerators)) {
    curve["iou"].push_back(step++ / double(kSteps));
    curve["recall"].push_back(at.value);
    curve["low"].push_back(at.low);
    curve["high"].push_back(at.high);
  }
  return curve;
}

}  // namespace mirage::paper
