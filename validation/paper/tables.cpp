#include "validation/paper/tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <set>

#include "base/files.h"
#include "validation/paper/matrix_markdown.h"
#include "validation/paper/repetitions.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

/// The case and all it needs.
void closure(const Experiments& experiments, const std::string& name, std::set<std::string>& names) {
  if (name.empty() || !names.insert(name).second) return;
  for (const std::string& need : experiments.at(name).needs) closure(experiments, need, names);
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

json value_of(const std::string& key, const Row& row, const Outcomes& outcomes) {
  if (key == "vanished") return to_json(vanished(outcomes));
  if (key == "fn_asr") return to_json(success(outcomes, is_hidden));
  if (key == "fp_asr") return to_json(success(outcomes, is_false_positive));
  if (key == "asr") return to_json(success(outcomes, is_fooled));
  if (key == "recall50") return to_json(recall(outcomes, 0.5, row.clean));
  if (key == "recall70") return to_json(recall(outcomes, 0.7, row.clean));
  if (key == "recall_mean") return to_json(mean_recall(outcomes, row.clean));
  return nullptr;
}

/// The learned mesh less a control; null for a column that is not net.
json net_of(const std::string& key, const Outcomes& learned, const Outcomes& control) {
  if (key == "net") return to_json(success_difference(learned, control, is_fooled));
  if (key == "net_vanished") return to_json(hiding_difference(learned, control, kHidingRules.front()));
  if (key == "net_fn_asr") return to_json(success_difference(learned, control, is_hidden));
  return nullptr;
}

json false_positive_distances(const Outcomes& outcomes) {
  json list = json::array();
  for (const Outcome& host : outcomes.hosts)
    if (host.detected)
      for (const double distance : host.distances) list.push_back(distance);
  return list;
}

json row_json(const Table& table, const Row& row, const Experiments& experiments, const Evidence& evidence) {
  std::set<std::string> names;
  if (!row.evaluation.empty())
    for (int number = 0; number < experiments.seeds; ++number)
      closure(experiments, repetition(row.evaluation, number), names);
  json entry = {{"label", row.label},
                {"rig", row.rig},
                {"case", row.evaluation},
                {"values", json::object()},
                {"paper", json::object()}};
  for (const auto& [key, percent] : row.paper) entry["paper"][key] = percent / 100;
  if (row.size > 0) entry["size"] = row.size;
  if (!row.source.empty()) entry["source"] = row.source, entry["target"] = row.target;
  const Outcomes* outcomes = row.random   ? evidence.random(row.evaluation)
                             : row.sized  ? evidence.sized(row.evaluation)
                             : row.cuboid ? evidence.cuboid(row.evaluation)
                                          : evidence.learned(row.evaluation);
  if (outcomes) {
    entry["vehicles"] = outcomes->vehicles;
    entry["hosts"] =
        outcomes->hosts.size() / static_cast<std::size_t>(std::max(1, outcomes->meshes * outcomes->runs));
    entry["frames"] = outcomes->frames();
    entry["meshes"] = outcomes->meshes;
    entry["runs"] = outcomes->runs;
    if (const std::string note = outcomes->note(); row.image && !note.empty()) entry["note"] = note;
    for (const Column& column : table.columns)
      if (const json value = value_of(column.key, row, *outcomes); !value.is_null())
        entry["values"][column.key] = value;
    const Outcomes* sized = row.random || row.sized ? nullptr : evidence.sized(row.evaluation);
    for (const Column& column : table.columns)
      if (const json net = sized ? net_of(column.key, *outcomes, *sized) : json(); !net.is_null())
        entry["values"][column.key] = net;
    if (table.name == "fig3") entry["curve"] = recall_curve(*outcomes, row.clean);
    if (table.name != "fig3" && !table.matrix)
      entry["false_positive_distances"] = false_positive_distances(*outcomes);
  } else {
    const std::string why = why_missing(names, evidence);
    entry["error"] =
        why.empty() ? row.evaluation + (row.cuboid ? ": judged no cuboid" : ": judged no random mesh") : why;
  }
  if (!row.detection.empty()) {
    closure(experiments, row.detection, names);
    const auto detection = evidence.detections.find(row.detection);
    if (detection != evidence.detections.end()) {
      for (const char* key : {"ap50", "ap70"})
        if (const std::string interval = std::string(key) + "_interval"; detection->second.contains(interval))
          entry["values"][key] = detection->second.at(interval);
        else if (detection->second.contains(key))
          entry["values"][key] = {{"value", detection->second.at(key)}};
    } else if (!entry.contains("error")) {
      entry["error"] = why_missing(names, evidence);
    }
  }
  double seconds = 0;
  bool known = false;
  for (const std::string& name : names) {
    if (experiments.at(name).kind == Case::Kind::data) continue;
    const auto step = evidence.steps.find(name);
    if (step == evidence.steps.end() || !(step->second.seconds > 0)) continue;
    seconds += step->second.seconds;
    known = true;
  }
  if (known) entry["minutes"] = seconds / 60;
  return entry;
}

std::string cell(const json& value) {
  if (!value.contains("low")) return fmt::format("{:.1f}", 100 * value.at("value").get<double>());
  return in_percent({value.at("value"), value.at("low"), value.at("high")});
}

/// ", 3 runs"
std::string more_than_one(const json& row, const char* key) {
  const int count = row.at(key);
  return count > 1 ? fmt::format(", {} {}", count, key) : "";
}

/// A bar in a cell would end it.
std::string escaped(const std::string& text) {
  std::string escaped_text;
  for (const char c : text) escaped_text += c == '|' ? "\\|" : c == '\n' ? " " : std::string(1, c);
  return escaped_text;
}

}  // namespace

std::string in_percent(const Interval& interval) {
  return fmt::format("{:.1f} ({:.1f}–{:.1f})", 100 * interval.value, 100 * interval.low, 100 * interval.high);
}

const Outcomes* Evidence::learned(const std::string& evaluation) const {
  const auto judged = evaluations.find(evaluation);
  return judged == evaluations.end() ? nullptr : judged->second.learned.get();
}

const Outcomes* Evidence::random(const std::string& evaluation) const {
  const auto judged = evaluations.find(evaluation);
  return judged == evaluations.end() ? nullptr : judged->second.random.get();
}

const Outcomes* Evidence::sized(const std::string& evaluation) const {
  const auto judged = evaluations.find(evaluation);
  return judged == evaluations.end() ? nullptr : judged->second.sized.get();
}

const Outcomes* Evidence::cuboid(const std::string& evaluation) const {
  const auto judged = evaluations.find(evaluation);
  return judged == evaluations.end() ? nullptr : judged->second.cuboid.get();
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
      if (command.kind == Case::Kind::detection) evidence.detections[command.name] = read_json(file);
      if (command.kind != Case::Kind::evaluation) continue;
      // Hosts are those of the data that were asked for, or else of the run that is judged or named for it.
      const Case& judged = experiments.at(command.needs.back());
      std::string data = argument(command, "--data");
      if (data.empty()) data = argument(judged, "--data", judged.name);
      judged_runs[command.name] = read_evaluation(file, data);
    } catch (const std::exception& error) {
      step.status = Step::Status::failed;
      step.error = error.what();
    }
  }
  // A repetition that failed is missing; what stands in for its experiment is the first, which has the name.
  for (const auto& [name, first] : judged_runs) {
    std::vector<Judged> runs{first};
    for (int number = 1; number < experiments.seeds; ++number)
      if (const auto more = judged_runs.find(repetition(name, number)); more != judged_runs.end())
        runs.push_back(more->second);
    if (!is_repetition(name)) evidence.evaluations[name] = pooled(runs);
  }
  evidence.steps = std::move(steps);
  return evidence;
}

json table_json(const Table& table, const Experiments& experiments, const Evidence& evidence) {
  json columns = json::array(), rows = json::array();
  for (const Column& column : table.columns)
    columns.push_back({{"key", column.key}, {"title", column.title}});
  for (const Row& row : table.rows) rows.push_back(row_json(table, row, experiments, evidence));
  return {{"name", table.name},     {"title", table.title}, {"note", table.note},
          {"matrix", table.matrix}, {"columns", columns},   {"rows", rows}};
}

std::string markdown(const json& table) {
  if (table.value("matrix", false)) return matrix_markdown(table);
  const auto& columns = table.at("columns");
  std::string text =
      fmt::format("## {}: {}\n\n", table.at("name").get<std::string>(), table.at("title").get<std::string>());
  if (const auto note = table.at("note").get<std::string>(); !note.empty()) text += note + "\n\n";
  bool rigs = false;
  std::set<std::string> paper;  // the columns for which the paper has a number
  for (const auto& row : table.at("rows")) {
    rigs = rigs || row.at("rig") != table.at("rows").front().at("rig");
    for (const auto& [key, value] : row.at("paper").items()) paper.insert(key);
  }
  text += rigs ? "| data | |" : "| |";
  std::string rule = rigs ? "|---|---|" : "|---|";
  for (const auto& column : columns) {
    text += fmt::format(" {}, % |", column.at("title").get<std::string>());
    rule += "---|";
    if (paper.contains(column.at("key"))) text += " paper |", rule += "---|";
  }
  text += " vehicles | minutes |\n" + rule + "---|---|\n";
  for (const auto& row : table.at("rows")) {
    text += rigs ? fmt::format("| {} | {} |", row.at("rig").get<std::string>(), escaped(row.at("label")))
                 : fmt::format("| {} |", escaped(row.at("label")));
    for (const auto& column : columns) {
      const auto key = column.at("key").get<std::string>();
      text += row.at("values").contains(key) ? " " + cell(row.at("values").at(key)) + " |" : " – |";
      if (paper.contains(key))
        text += row.at("paper").contains(key)
                    ? fmt::format(" {:.2f} |", 100 * row.at("paper").at(key).get<double>())
                    : " |";
    }
    text += " ";
    if (row.contains("vehicles"))
      text += fmt::format("{} in {} frames{}{}", row.at("vehicles").get<int>(), row.at("frames").get<int>(),
                          more_than_one(row, "meshes"), more_than_one(row, "runs"));
    if (row.contains("note")) text += "; " + escaped(row.at("note"));
    if (row.contains("error")) text += (row.contains("vehicles") ? "; " : "") + escaped(row.at("error"));
    text += " |";
    text += row.contains("minutes") ? fmt::format(" {:.1f} |\n", row.at("minutes").get<double>()) : " |\n";
  }
  return text + "\n";
}

}  // namespace mirage::paper
