#include "validation/paper/results.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <set>
#include <span>
#include <tuple>

#include "attack/baseline.h"
#include "attack/evaluation.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/sizes.h"

namespace mirage::paper {
namespace {

/// A host's place: the same in the evaluations of one data set.
auto place_of(const Outcome& host) {
  return std::tuple(host.id.frame, host.id.label, host.run);
}
using Places = std::set<std::tuple<std::string, int, int>>;

Places places_of(const Outcomes& outcomes) {
  Places places;
  for (const Outcome& host : outcomes.hosts) places.insert(place_of(host));
  return places;
}

Outcomes read_arm(const JsonFields& evaluation, const std::string& data) {
  Outcomes mesh_outcomes;
  mesh_outcomes.data = data;
  mesh_outcomes.vehicles = evaluation.count("vehicles");
  for (HostOutcome& host : read_outcomes(evaluation)) {
    mesh_outcomes.meshes = std::max(mesh_outcomes.meshes, host.mesh + 1);
    mesh_outcomes.hosts.push_back({std::move(host)});
  }
  return mesh_outcomes;
}

template <class Keep>
ClusteredShare share_of(const Outcomes& outcomes, const Question& question, const Keep& keep) {
  ClusteredShare share;
  for (const Outcome& host : outcomes.hosts)
    if (keep(host) && question.counts(host))
      share.add(host.cluster(), question.holds(host), host.run, 1.0 / outcomes.meshes);
  return share;
}

constexpr auto everyone = [](const Outcome&) { return true; };
constexpr auto is_detected = [](const Outcome& host) { return host.detected; };

bool has_far_one(const Outcome& host) {
  const std::vector<double> all = host.distances();
  return std::any_of(all.begin(), all.end(), [](double distance) { return distance > kFar; });
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

Judged read_evaluation(const std::filesystem::path& file, const std::string& data) {
  const nlohmann::json json = read_json(file);
  const JsonFields fields(file, json, kMakeAgain);
  Judged judged;
  Outcomes& learned = judged["learned"] = read_arm(fields, data);
  learned.name = "learned mesh";
  if (fields.has("reliance") && !fields.is_null("reliance"))
    learned.reliance = reliance_from_json(fields.object("reliance"));
  for (const auto& [key, kind] : {std::pair("random", Baseline::start), std::pair("sized", Baseline::sized),
                                  std::pair("cuboid", Baseline::cuboid)}) {
    if (!fields.has(key) || fields.is_null(key)) continue;
    Outcomes& mesh_outcomes = judged[to_word(kind)] = read_arm(fields.object(key), data);
    mesh_outcomes.reliance = learned.reliance;
    mesh_outcomes.name = describe(kind);
  }
  return judged;
}

Judged pooled(const std::map<int, Judged>& runs) {
  Judged all;
  for (const auto& [mesh, first] : runs.begin()->second) {
    if (!std::all_of(runs.begin(), runs.end(), [&](const auto& run) { return run.second.contains(mesh); }))
      continue;
    Outcomes& pool = all[mesh] = first;
    pool.hosts.clear();
    pool.runs = static_cast<int>(runs.size());
    for (const auto& [number, run] : runs) {
      const Outcomes& own = run.at(mesh);
      pool.meshes = std::max(pool.meshes, own.meshes);
      for (const Outcome& host : own.hosts) {
        pool.hosts.push_back(host);
        pool.hosts.back().run = number;
      }
    }
    pool.vehicles = vehicles(pool, question("asr"));
  }
  return all;
}

Question question(const std::string& key) {
  if (key == "fn_asr") return {is_detected, [](const Outcome& host) { return host.hidden; }};
  if (key == "fp_asr") return {is_detected, [](const Outcome& host) { return host.false_positive; }};
  const auto fooled = [](const Outcome& host) { return host.fooled(); };
  if (key == "asr") return {is_detected, fooled};
  if (key == "near_asr" || key == "beyond_asr")
    return {[near = key == "near_asr"](const Outcome& host) {
              return host.detected && (host.range < 30) == near;
            },
            fooled};
  if (key == "close") return {is_detected, [](const Outcome& host) { return host.clean_iou < 0.75; }};
  if (key == "far") return {is_detected, has_far_one};
  for (const bool clean : {false, true})
    for (const int iou : {50, 70})
      if (key == (clean ? "clean_recall" : "recall") + std::to_string(iou)) return recall(iou / 100.0, clean);
  for (const MissCriterion& rule : kMissCriteria)
    if (key == rule.name)
      return {[rule](const Outcome& host) { return rule.finds(host, true); },
              [rule](const Outcome& host) { return !rule.finds(host, false); }};
  throw InputError("question", key, "is not a question", "use a key of results.h");
}

Question recall(double iou, bool clean) {
  return {everyone, [=](const Outcome& host) { return found(host, iou, clean); }};
}

Interval share(const Outcomes& outcomes, const Question& question) {
  return share_of(outcomes, question, everyone).interval();
}

int vehicles(const Outcomes& outcomes, const Question& question) {
  std::set<std::pair<std::string, int>> names;
  for (const Outcome& host : outcomes.hosts)
    if (question.counts(host)) names.insert({host.id.frame, host.id.label});
  return static_cast<int>(names.size());
}

bool has_metres(const Outcomes& outcomes) {
  return std::any_of(outcomes.hosts.begin(), outcomes.hosts.end(),
                     [](const Outcome& host) { return std::isfinite(host.clean_distance); });
}

int clusters_of(const Estimate& estimate) {
  return 1 + static_cast<int>(std::clamp(std::floor(estimate.freedom), 0.0, kManyClusters - 1.0));
}

Difference difference(const std::vector<Term>& terms, const Question& question) {
  std::vector<Places> places;
  for (const Term& term : terms) places.push_back(places_of(*term.of));
  const auto in_all = [&](const Outcome& host) {
    return std::all_of(places.begin(), places.end(),
                       [&](const Places& one) { return one.contains(place_of(host)); });
  };
  std::vector<ClusteredShare> shares;
  std::vector<double> factors;
  for (const Term& term : terms) {
    shares.push_back(share_of(*term.of, question, in_all));
    factors.push_back(term.factor);
  }
  const Interval interval = factors == std::vector<double>{1, -1} ? share_difference(shares[0], shares[1])
                                                                  : combined_shares(shares, factors);
  return {interval, clusters_of(combined_estimate(shares, factors))};
}

Outcomes shared_hosts(const Outcomes& a, const Outcomes& b) {
  Outcomes shared = a;
  std::erase_if(shared.hosts,
                [places = places_of(b)](const Outcome& host) { return !places.contains(place_of(host)); });
  shared.vehicles = vehicles(shared, question("asr"));
  return shared;
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

nlohmann::json recall_curve(const Outcomes& outcomes, bool clean) {
  nlohmann::json curve;
  for (int step = 0; step <= kSteps; ++step) {
    const double iou = step / double(kSteps);
    const Interval at = share(outcomes, recall(iou, clean));
    curve["iou"].push_back(iou);
    curve["recall"].push_back(at.value);
    curve["low"].push_back(at.low);
    curve["high"].push_back(at.high);
  }
  return curve;
}

nlohmann::json to_json(const Step& step) {
  const char* words[] = {"missing", "done", "failed"};
  nlohmann::json entry = {{"status", words[static_cast<int>(step.status)]}};
  if (!step.error.empty()) entry["error"] = step.error;
  if (step.seconds > 0) entry["seconds"] = step.seconds;
  return entry;
}

nlohmann::json read_detection(const std::filesystem::path& file) {
  const nlohmann::json json = read_json(file);
  const JsonFields fields(file, json, kMakeAgain);
  nlohmann::json detection = nlohmann::json::object();
  for (const std::string key : {"ap50", "ap70"}) {
    if (fields.has(key + "_interval")) {
      const JsonFields interval = fields.object(key + "_interval");
      detection[key] = {{"value", interval.number("value", 0, Range::kMax)}};
      for (const char* bound : {"low", "high"})  // null for what is infinite
        detection[key][bound] = interval.is_null(bound)
                                    ? nlohmann::json()
                                    : nlohmann::json(interval.number(bound, -Range::kMax, Range::kMax));
    } else if (fields.has(key)) {
      detection[key] = {{"value", fields.number(key, 0, Range::kMax)}};
    }
  }
  return detection;
}

const Outcomes* Evidence::of(const std::string& evaluation, const std::string& mesh) const {
  const auto judged = evaluations.find(evaluation);
  if (judged == evaluations.end()) return nullptr;
  const auto own = judged->second.find(mesh);
  return own == judged->second.end() ? nullptr : &own->second;
}

Evidence gather(const Experiments& experiments, const std::filesystem::path& out,
                std::map<std::string, Step> steps) {
  Evidence evidence;
  std::map<std::string, Judged> judged_runs;
  for (const Case& command : experiments.cases) {
    Step& step = steps[command.name];
    if (step.status != Step::Status::done) continue;
    const auto file = out / command.name / "result.json";
    try {
      if (command.kind == Case::Kind::detect) evidence.detections[command.name] = read_detection(file);
      if (command.kind != Case::Kind::evaluate) continue;
      // Hosts are those of the data that were asked for, or else of the run that is judged or named for it.
      const NamedSettings own = command.settings_in(out);
      const auto data = own.find("data");
      judged_runs[command.name] = read_evaluation(
          file,
          data != own.end() ? data->second : experiments.at(command.hosts_of()).settings_in(out).at("data"));
    } catch (const std::exception& error) {
      step.status = Step::Status::failed;
      step.error = error.what();
    }
  }
  // A failed repetition is missing. The first run has the experiment's name and stands for the experiment.
  for (const auto& [name, first] : judged_runs) {
    if (is_repetition(name)) continue;
    std::map<int, Judged> runs{{0, first}};
    for (int number = 1; number < experiments.seeds; ++number)
      if (const auto more = judged_runs.find(repetition(name, number)); more != judged_runs.end())
        runs[number] = more->second;
    evidence.evaluations[name] = pooled(runs);
  }
  evidence.steps = std::move(steps);
  return evidence;
}

}  // namespace mirage::paper
