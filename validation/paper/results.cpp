#include "validation/paper/results.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "attack/baseline.h"
#include "attack/evaluation.h"
#include "base/files.h"
#include "base/json_fields.h"

namespace mirage::paper {
namespace {

std::shared_ptr<Outcomes> read_arm(const JsonFields& evaluation, const std::string& data) {
  auto arm = std::make_shared<Outcomes>();
  arm->data = data;
  arm->vehicles = evaluation.count("vehicles");
  for (HostOutcome& host : read_outcomes(evaluation)) {
    arm->meshes = std::max(arm->meshes, host.mesh + 1);
    arm->hosts.push_back({std::move(host)});
  }
  return arm;
}

ClusteredShare share_of(const Outcomes& outcomes, const Which& counts, const Which& which) {
  ClusteredShare share;
  for (const Outcome& host : outcomes.hosts)
    if (counts(host)) share.add(host.cluster(), which(host), host.run, 1.0 / outcomes.meshes);
  return share;
}

/// Hosts detected clean, each once whatever the meshes and runs.
int count_vehicles(const std::vector<Outcome>& hosts) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : hosts)
    if (host.detected) names.insert({host.id.frame, host.id.label});
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

std::vector<double> Outcome::distances() const {
  std::vector<double> metres;
  if (!matching.in_picture())
    for (const NewBox& box : new_boxes) metres.push_back(box.distance);
  return metres;
}

int Outcomes::frames() const {
  std::set<std::string> names;
  for (const Outcome& host : hosts) names.insert(host.id.frame);
  return static_cast<int>(names.size());
}

std::string Outcomes::note() const {
  return reliance ? picture_note(*reliance) : "";
}

ClusterCount Outcomes::clusters() const {
  Clusters clusters;
  for (const Outcome& host : hosts)
    if (host.detected) clusters.add(host.id.frame, host.track);
  return clusters.count();
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
  const JsonFields fields(file, json, kMakeAgain);
  const auto learned = read_arm(fields, data);
  learned->name = "learned mesh";
  if (fields.has("reliance") && !fields.is_null("reliance"))
    learned->reliance = reliance_from_json(fields.object("reliance"));
  const auto other = [&](const char* key, Baseline kind) -> std::shared_ptr<const Outcomes> {
    if (!fields.has(key) || fields.is_null(key)) return nullptr;
    const auto arm = read_arm(fields.object(key), data);
    arm->reliance = learned->reliance;
    arm->name = describe(kind);
    return arm;
  };
  return {learned, other("random", Baseline::start), other("sized", Baseline::sized),
          other("cuboid", Baseline::cuboid)};
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
  return share_of(outcomes, is_detected, which).interval();
}

static ClusteredShare hiding_share(const Outcomes& outcomes, const HidingRule& rule) {
  return share_of(
      outcomes, [&](const Outcome& host) { return rule.finds(host, true); },
      [&](const Outcome& host) { return !rule.finds(host, false); });
}

std::optional<Interval> hiding(const Outcomes& outcomes, const HidingRule& rule) {
  const auto has_metres = [](const Outcome& host) { return std::isfinite(host.clean_distance); };
  if (rule.distance > 0 && std::none_of(outcomes.hosts.begin(), outcomes.hosts.end(), has_metres))
    return std::nullopt;
  return hiding_share(outcomes, rule).interval();
}

int found_clean(const Outcomes& outcomes, const HidingRule& rule) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : outcomes.hosts)
    if (rule.finds(host, true)) names.insert({host.id.frame, host.id.label});
  return static_cast<int>(names.size());
}

Interval vanished(const Outcomes& outcomes) {
  return *hiding(outcomes, kHidingRules.front());
}

Outcomes shared_hosts(const Outcomes& a, const Outcomes& b) {
  std::set<std::tuple<std::string, int, int>> names;
  for (const Outcome& host : b.hosts) names.insert({host.id.frame, host.id.label, host.run});
  return part(a, [&](const Outcome& host) {
    return names.contains({host.id.frame, host.id.label, host.run});
  });
}

Outcomes part(const Outcomes& outcomes, const Which& keep) {
  Outcomes kept = outcomes;
  std::erase_if(kept.hosts, [&](const Outcome& host) { return !keep(host); });
  kept.vehicles = count_vehicles(kept.hosts);
  return kept;
}

static Interval paired_difference(const Outcomes& a, const Outcomes& b, const Which& counts,
                                  const Which& which) {
  return share_difference(share_of(shared_hosts(a, b), counts, which),
                          share_of(shared_hosts(b, a), counts, which));
}

Interval hiding_difference(const Outcomes& a, const Outcomes& b, const HidingRule& rule) {
  return share_difference(hiding_share(shared_hosts(a, b), rule), hiding_share(shared_hosts(b, a), rule));
}

Interval net_difference(const NetOf& a, const NetOf& b, const HidingRule& rule) {
  const std::array<const Outcomes*, 4> of = {a.learned, a.control, b.learned, b.control};
  std::vector<ClusteredShare> shares;
  for (const Outcomes* outcomes : of) {
    Outcomes shared = *outcomes;
    for (const Outcomes* other : of) shared = shared_hosts(shared, *other);
    shares.push_back(hiding_share(shared, rule));
  }
  return combined_shares(shares, std::array{1.0, -1.0, -1.0, 1.0});
}

Interval success_difference(const Outcomes& a, const Outcomes& b, const Which& which) {
  return paired_difference(a, b, is_detected, which);
}

Interval clean_recall_difference(const Outcomes& a, const Outcomes& b, double iou) {
  return paired_difference(
      a, b, [](const Outcome&) { return true; }, [&](const Outcome& host) { return found(host, iou, true); });
}

Interval recall(const Outcomes& outcomes, double iou, bool clean) {
  return share_of(
             outcomes, [](const Outcome&) { return true; },
             [&](const Outcome& host) { return found(host, iou, clean); })
      .interval();
}

Interval mean_recall(const Outcomes& outcomes, bool clean) {
  ClusteredShare all;
  for (const Outcome& host : outcomes.hosts) {
    double steps = 0;
    for (int step = 0; step <= kSteps; ++step) steps += found(host, step / double(kSteps), clean);
    all.add(host.cluster(), steps / (kSteps + 1), host.run, 1.0 / outcomes.meshes);
  }
  return all.interval();
}

RecallCurve recall_curve(const Outcomes& outcomes, bool clean) {
  RecallCurve curve;
  for (int step = 0; step <= kSteps; ++step) {
    curve.iou.push_back(step / double(kSteps));
    curve.recall.push_back(recall(outcomes, curve.iou.back(), clean));
  }
  return curve;
}

nlohmann::json to_json(const RecallCurve& curve) {
  nlohmann::json json = {{"iou", curve.iou}};
  for (const Interval& at : curve.recall) {
    json["recall"].push_back(at.value);
    json["low"].push_back(at.low);
    json["high"].push_back(at.high);
  }
  return json;
}

}  // namespace mirage::paper
