#include "validation/paper/tables.h"

#include <algorithm>
#include <set>

namespace mirage::paper {
namespace {

using nlohmann::json;

/// The case and all it needs.
void closure(const Experiments& experiments, const std::string& name, std::set<std::string>& names) {
  if (name.empty() || !names.insert(name).second) return;
  for (const auto& [folder, need] : experiments.at(name).needs) closure(experiments, need, names);
}

/// Why the row has no numbers: what failed by itself rather than what was left out for it.
std::string why_missing(const std::set<std::string>& names, const Evidence& evidence) {
  std::string why;
  for (const std::string& name : names) {
    const auto step = evidence.steps.find(name);
    if (step == evidence.steps.end() || step->second.status == Step::Status::missing) {
      if (why.empty()) why = name + ": not run";
    } else if (step->second.status == Step::Status::failed) {
      why = name + ": " + step->second.error;
      if (!step->second.error.starts_with("needs ")) return why;
    }
  }
  return why;
}

/// Of the row's mesh, or net of its control; null for a column of another kind.
json value_of(const std::string& key, const Row& row, const Outcomes& outcomes, const Outcomes* sized) {
  if (key == "recall_mean") return to_json(mean_recall(outcomes, row.mesh == "none"));
  if (key.starts_with("recall"))
    return to_json(share(outcomes, question((row.mesh == "none" ? "clean_" : "") + key)));
  if (key.starts_with("ap")) return nullptr;
  if (!key.starts_with("net")) return to_json(share(outcomes, question(key)));
  const Question asked = question(key == "net" ? "asr" : key.substr(4));
  return sized ? to_json(difference(outcomes, *sized, asked)) : json();
}

/// What the row's meshes did; `sized`: their control, if they have one.
void add_outcomes(json& entry, const Table& table, const Row& row, const Outcomes& outcomes,
                  const Outcomes* sized) {
  const ClusterCount clusters = outcomes.clusters();
  entry.update({{"vehicles", outcomes.vehicles},
                {"hosts", outcomes.hosts.size() /
                              static_cast<std::size_t>(std::max(1, outcomes.meshes * outcomes.runs))},
                {"frames", outcomes.frames()},
                {"meshes", outcomes.meshes},
                {"runs", outcomes.runs},
                {"clusters", to_json(clusters)}});
  if (clusters.count < kFewClusters) entry["few_clusters"] = to_string(clusters);
  if (row.image && !outcomes.note().empty()) entry["note"] = outcomes.note();
  for (const Column& column : table.columns)
    if (json value = value_of(column.key, row, outcomes, sized); !value.is_null())
      entry["values"][column.key] = std::move(value);
  if (table.name == "fig3") {
    entry["curve"] = recall_curve(outcomes, row.mesh == "none");
  } else if (!table.matrix) {
    json& list = entry["false_positive_distances"] = json::array();
    for (const Outcome& host : outcomes.hosts)
      if (host.detected)
        for (const double distance : host.distances()) list.push_back(distance);
  }
}

/// Of the cases that are no data; none where none of them knows.
std::optional<double> minutes(const std::set<std::string>& names, const Experiments& experiments,
                              const Evidence& evidence) {
  double seconds = 0;
  for (const std::string& name : names)
    if (const auto step = evidence.steps.find(name);
        step != evidence.steps.end() && experiments.at(name).kind != Case::Kind::generate)
      seconds += step->second.seconds;
  return seconds > 0 ? std::optional(seconds / 60) : std::nullopt;
}

json row_json(const Table& table, const Row& row, const Experiments& experiments, const Evidence& evidence) {
  std::set<std::string> names;
  if (!row.evaluation.empty())
    for (int number = 0; number < experiments.seeds; ++number)
      closure(experiments, repetition(row.evaluation, number), names);
  json entry = {{"label", row.label}, {"rig", row.rig}, {"case", row.evaluation}};
  json& values = entry["values"] = json::object();
  json& paper = entry["paper"] = json::object();
  for (const auto& [key, percent] : row.paper) paper[key] = percent / 100;
  if (row.size > 0) entry["size"] = row.size;
  if (!row.source.empty()) entry.update({{"source", row.source}, {"target", row.target}});
  const bool control = row.mesh == "start" || row.mesh == "sized";
  std::string why;
  if (const Outcomes* outcomes =
          evidence.of(row.evaluation, control || row.mesh == "cuboid" ? row.mesh : "learned")) {
    add_outcomes(entry, table, row, *outcomes, control ? nullptr : evidence.of(row.evaluation, "sized"));
  } else {
    why = why_missing(names, evidence);
    if (why.empty())
      why = row.evaluation + (row.mesh == "cuboid" ? ": judged no cuboid" : ": judged no random mesh");
  }
  if (!row.detection.empty()) {
    closure(experiments, row.detection, names);
    if (const auto clean = evidence.detections.find(row.detection); clean != evidence.detections.end())
      values.update(clean->second);
    else if (why.empty())
      why = why_missing(names, evidence);
  }
  if (!why.empty()) entry["error"] = why;
  if (const auto spent = minutes(names, experiments, evidence)) entry["minutes"] = *spent;
  return entry;
}

/// "kitti64" of "kitti64-fusion-both--on--xenith-fusion-both": "xenith", whose frames they are.
std::string rig_of(const std::string& arm) {
  const std::size_t on = arm.find("--on--");
  const std::string judged = on == std::string::npos ? arm : arm.substr(on + 6);
  return judged.substr(0, judged.find('-'));
}

/// By each rule; null where it asks for metres and there are none. `control`: the net of it, if it is not
/// null.
json hidden_json(const Outcomes& outcomes, const Outcomes* control) {
  json rates = json::object();
  for (const HidingRule& rule : kHidingRules) {
    const Question asked = question(rule.name);
    json& rate = rates[rule.name];
    if (rule.distance > 0 && !has_metres(outcomes)) continue;
    rate = to_json(control ? difference(outcomes, *control, asked) : share(outcomes, asked));
    if (!control) rate["vehicles"] = vehicles(outcomes, asked);
  }
  return rates;
}

}  // namespace

json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence) {
  json columns = json::array(), rows = json::array();
  for (const Column& column : table.columns)
    columns.push_back({{"key", column.key}, {"title", column.title}});
  for (const Row& row : table.rows) rows.push_back(row_json(table, row, experiments, evidence));
  return {{"name", table.name},     {"title", table.title}, {"note", table.note},
          {"matrix", table.matrix}, {"columns", columns},   {"rows", rows}};
}

json arms_json(const Experiments& experiments, const ReproduceSettings& settings, const Evidence& evidence) {
  json list = json::array();
  for (const Case& command : experiments.cases) {
    if (command.kind != Case::Kind::evaluate || is_repetition(command.name)) continue;
    const Case &attack = experiments.at(command.run()), &stage = experiments.at(command.hosts_of());
    for (const std::string mesh : {"learned", "start", "sized", "cuboid"}) {
      const Outcomes *outcomes = evidence.of(command.name, mesh), *sized = evidence.of(command.name, "sized");
      if (!outcomes) continue;
      const std::string name = command.name.substr(command.name.find('/') + 1);
      json arm = {
          {"name", name},
          {"detector", attack.setting("detector")},
          {"target", attack.setting("target")},
          {"rig", rig_of(name)},
          {"judge", command.setting("detector", stage.setting("detector"))},
          {"mesh", mesh},
          {"seeds", json::array()},
          {"vehicles", outcomes->vehicles},
          {"frames", outcomes->frames()},
          {"hidden", hidden_json(*outcomes, nullptr)},
          {"fp_asr", to_json(share(*outcomes, question("fp_asr")))},
          {"interval",
           {{"confidence", kConfidence}, {"drawn", outcomes->runs > 1 ? "runs and clusters" : "clusters"}}}};
      for (int run = 0; run < outcomes->runs; ++run)
        arm["seeds"].push_back(settings.seed + static_cast<std::uint64_t>(run));
      for (const char* varied : {"defense", "parts"})
        if (const std::string word = attack.setting(varied); !word.empty()) arm[varied] = word;
      if (mesh == "learned" && sized) arm["net"] = hidden_json(*outcomes, sized);
      list.push_back(std::move(arm));
    }
  }
  return list;
}

}  // namespace mirage::paper
