#include "validation/paper/tables.h"

#include <algorithm>
#include <set>

#include "validation/paper/evidence.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

/// "kitti64" of "kitti64-fusion-both--on--xenith-fusion-both": "xenith", whose frames they are.
std::string rig_of(const std::string& arm) {
  const std::size_t on = arm.find("--on--");
  const std::string judged = on == std::string::npos ? arm : arm.substr(on + 6);
  return judged.substr(0, judged.find('-'));
}

HidingRates rates(const Outcomes& outcomes) {
  const auto of = [&](std::size_t rule) -> std::optional<HidingRate> {
    const auto share = hiding(outcomes, kHidingRules[rule]);
    if (!share) return std::nullopt;
    return HidingRate{*share, found_clean(outcomes, kHidingRules[rule])};
  };
  return {*of(0), *of(1), *of(2), of(3), of(4)};
}

/// The learned mesh's, where it has a control of its size.
void add_net(Arm& arm, const Outcomes& learned, const Outcomes& sized) {
  auto& net = arm.net.emplace();
  for (std::size_t i = 0; i < net.size(); ++i)
    if (hiding(learned, kHidingRules[i])) net[i] = hiding_difference(learned, sized, kHidingRules[i]);
}

}  // namespace

std::vector<Arm> evaluation_arms(const Experiments& experiments, const ReproduceSettings& settings,
                                 const Evidence& evidence) {
  std::vector<Arm> list;
  for (const Case& command : experiments.cases) {
    if (command.kind != Case::Kind::evaluate || is_repetition(command.name)) continue;
    const auto found = evidence.evaluations.find(command.name);
    if (found == evidence.evaluations.end()) continue;
    const Judged& judged = found->second;
    const Case &attack = experiments.at(command.run()), &stage = experiments.at(command.hosts_of());
    for (const auto& [mesh, outcomes] :
         {std::pair("learned", judged.learned), std::pair("start", judged.random),
          std::pair("sized", judged.sized), std::pair("cuboid", judged.cuboid)}) {
      if (!outcomes) continue;
      Arm arm;
      arm.name = command.name.substr(command.name.find('/') + 1);
      arm.detector = attack.setting("detector");
      arm.target = attack.setting("target");
      arm.defense = attack.setting("defense");
      arm.parts = attack.setting("parts");
      arm.rig = rig_of(arm.name);
      arm.judge = command.setting("detector", stage.setting("detector"));
      arm.mesh = mesh;
      for (int run = 0; run < outcomes->runs; ++run)
        arm.seeds.push_back(settings.seed + static_cast<std::uint64_t>(run));
      arm.vehicles = outcomes->vehicles;
      arm.frames = outcomes->frames();
      arm.hiding = rates(*outcomes);
      if (outcomes == judged.learned && judged.sized) add_net(arm, *outcomes, *judged.sized);
      arm.false_positives = success(*outcomes, is_false_positive);
      list.push_back(std::move(arm));
    }
  }
  return list;
}

json to_json(const Arm& arm) {
  json result = {
      {"name", arm.name},
      {"detector", arm.detector},
      {"target", arm.target},
      {"rig", arm.rig},
      {"judge", arm.judge},
      {"mesh", arm.mesh},
      {"seeds", arm.seeds},
      {"vehicles", arm.vehicles},
      {"frames", arm.frames},
      {"hidden", to_json(arm.hiding)},
      {"fp_asr", to_json(arm.false_positives)},
      {"interval",
       {{"confidence", kConfidence}, {"drawn", arm.seeds.size() > 1 ? "runs and clusters" : "clusters"}}}};
  if (!arm.defense.empty()) result["defense"] = arm.defense;
  if (!arm.parts.empty()) result["parts"] = arm.parts;
  if (arm.net)
    for (std::size_t i = 0; i < arm.net->size(); ++i) {
      const auto& net = (*arm.net)[i];
      result["net"][kHidingRules[i].name] = net ? to_json(*net) : json();
    }
  return result;
}

namespace {

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

/// None for a column of another kind.
std::optional<Interval> value_of(const std::string& key, const Row& row, const Outcomes& outcomes) {
  if (key == "vanished") return vanished(outcomes);
  if (key == "fn_asr") return success(outcomes, is_hidden);
  if (key == "fp_asr") return success(outcomes, is_false_positive);
  if (key == "asr") return success(outcomes, is_fooled);
  if (key == "recall50") return recall(outcomes, 0.5, row.clean);
  if (key == "recall70") return recall(outcomes, 0.7, row.clean);
  if (key == "recall_mean") return mean_recall(outcomes, row.clean);
  return std::nullopt;
}

/// The learned mesh less a control; none for a column that is not net.
std::optional<Interval> net_of(const std::string& key, const Outcomes& learned, const Outcomes& control) {
  if (key == "net") return success_difference(learned, control, is_fooled);
  if (key == "net_vanished") return hiding_difference(learned, control, kHidingRules.front());
  if (key == "net_fn_asr") return success_difference(learned, control, is_hidden);
  return std::nullopt;
}

std::vector<double> false_positive_distances(const Outcomes& outcomes) {
  std::vector<double> list;
  for (const Outcome& host : outcomes.hosts)
    if (host.detected)
      for (const double distance : host.distances()) list.push_back(distance);
  return list;
}

/// What the row's meshes did; `sized`: their control, if they have one.
void add_outcomes(RowResult& result, const Table& table, const Row& row, const Outcomes& outcomes,
                  const Outcomes* sized) {
  const std::size_t passes = static_cast<std::size_t>(std::max(1, outcomes.meshes * outcomes.runs));
  result.counts = {outcomes.vehicles, outcomes.hosts.size() / passes,
                   outcomes.frames(), outcomes.meshes,
                   outcomes.runs,     outcomes.clusters()};
  if (row.image) result.note = outcomes.note();
  for (const Column& column : table.columns) {
    auto value = value_of(column.key, row, outcomes);
    if (!value && sized) value = net_of(column.key, outcomes, *sized);
    if (value) result.values[column.key] = {*value};
  }
  if (table.name == "fig3")
    result.curve = recall_curve(outcomes, row.clean);
  else if (!table.matrix)
    result.false_positive_distances = false_positive_distances(outcomes);
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

RowResult row_result(const Table& table, const Row& row, const Experiments& experiments,
                     const Evidence& evidence) {
  std::set<std::string> names;
  if (!row.evaluation.empty())
    for (int number = 0; number < experiments.seeds; ++number)
      closure(experiments, repetition(row.evaluation, number), names);
  RowResult result;
  result.label = row.label;
  result.rig = row.rig;
  result.source = row.source;
  result.target = row.target;
  result.evaluation = row.evaluation;
  result.size = row.size;
  for (const auto& [key, percent] : row.paper) result.paper[key] = percent / 100;
  const Outcomes* outcomes = row.random   ? evidence.random(row.evaluation)
                             : row.sized  ? evidence.sized(row.evaluation)
                             : row.cuboid ? evidence.cuboid(row.evaluation)
                                          : evidence.learned(row.evaluation);
  if (outcomes) {
    const Outcomes* sized = row.random || row.sized ? nullptr : evidence.sized(row.evaluation);
    add_outcomes(result, table, row, *outcomes, sized);
  } else {
    result.error = why_missing(names, evidence);
    if (result.error.empty())
      result.error = row.evaluation + (row.cuboid ? ": judged no cuboid" : ": judged no random mesh");
  }
  if (!row.detection.empty()) {
    closure(experiments, row.detection, names);
    if (const auto clean = evidence.detections.find(row.detection); clean != evidence.detections.end()) {
      if (clean->second.ap50) result.values["ap50"] = *clean->second.ap50;
      if (clean->second.ap70) result.values["ap70"] = *clean->second.ap70;
    } else if (result.error.empty()) {
      result.error = why_missing(names, evidence);
    }
  }
  result.minutes = minutes(names, experiments, evidence);
  return result;
}

json row_json(const RowResult& row) {
  json entry = {{"label", row.label},
                {"rig", row.rig},
                {"case", row.evaluation},
                {"values", json::object()},
                {"paper", row.paper}};
  for (const auto& [key, value] : row.values) entry["values"][key] = to_json(value);
  if (row.size > 0) entry["size"] = row.size;
  if (!row.source.empty()) entry.update({{"source", row.source}, {"target", row.target}});
  if (row.counts)
    entry.update({{"vehicles", row.counts->vehicles},
                  {"hosts", row.counts->hosts},
                  {"frames", row.counts->frames},
                  {"meshes", row.counts->meshes},
                  {"runs", row.counts->runs},
                  {"clusters", to_json(row.counts->clusters)}});
  if (row.counts && row.counts->clusters.count < kFewClusters)
    entry["few_clusters"] = to_string(row.counts->clusters);
  if (!row.note.empty()) entry["note"] = row.note;
  if (!row.error.empty()) entry["error"] = row.error;
  if (row.curve) entry["curve"] = to_json(*row.curve);
  if (row.false_positive_distances) entry["false_positive_distances"] = *row.false_positive_distances;
  if (row.minutes) entry["minutes"] = *row.minutes;
  return entry;
}

}  // namespace

TableResult table_result(const Table& table, const Experiments& experiments, const Evidence& evidence) {
  TableResult result{table.name, table.title, table.note, table.matrix, table.columns, {}};
  for (const Row& row : table.rows) result.rows.push_back(row_result(table, row, experiments, evidence));
  return result;
}

json to_json(const TableResult& table) {
  json columns = json::array(), rows = json::array();
  for (const Column& column : table.columns)
    columns.push_back({{"key", column.key}, {"title", column.title}});
  for (const RowResult& row : table.rows) rows.push_back(row_json(row));
  return {{"name", table.name},     {"title", table.title}, {"note", table.note},
          {"matrix", table.matrix}, {"columns", columns},   {"rows", rows}};
}

}  // namespace mirage::paper
