#include "validation/paper/fusions.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "validation/paper/tables.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

const std::vector<Column> kCell = {{"vanished", "vanished"},
                                   {"net_vanished", "vanished, net of its size"},
                                   {"fn_asr", "missed at IoU 0.7"},
                                   {"net_fn_asr", "missed at IoU 0.7, net of its size"},
                                   {"fp_asr", "FP ASR"}};
constexpr const char* kCuboid = "no learning: cuboid";

std::vector<Attacked> attacks(bool quick) {
  std::vector<Attacked> all;
  for (const std::string& detector : fusion_detectors()) {
    const bool fused = through_all(detector).target == "both";
    if (quick && fused && detector != "fusion") continue;
    if (fused)
      for (const char* target : {"image", "lidar"}) all.push_back({detector, target});
    all.push_back(through_all(detector));
  }
  return all;
}

std::string words(const Attacked& one) {
  return one.detector + ", " + (one.target == "lidar" ? "LiDAR" : one.target);
}

/// One row for each mesh and judge; `judged` names, and adds, the evaluation.
template <class Judged>
void add_rows(Table& table, const std::string& rig, bool quick, const Judged& judged) {
  std::set<std::string> judges;
  for (const Attacked& one : attacks(quick)) judges.insert(one.detector);
  const auto add = [&](const std::string& source, const std::string& judge, const std::string& evaluation) {
    Row row;
    row.label = source + " → " + judge;
    row.rig = rig;
    row.evaluation = evaluation;
    row.source = source;
    row.target = judge;
    table.rows.push_back(row);
    return &table.rows.back();
  };
  for (const Attacked& one : attacks(quick))
    for (const std::string& judge : fusion_detectors())
      if (judges.contains(judge))
        add(words(one), judge, judged(one, judge))->image = one.target == "image" && one.detector == judge;
  for (const std::string& judge : fusion_detectors())
    if (judges.contains(judge)) add(kCuboid, judge, judged(through_all(judge), judge))->cuboid = true;
}

constexpr const char* kNote =
    "Rows: against which detector, and through which of its sensors, the mesh was learned; columns: who "
    "judges it, on the same vehicles. Net: less a random mesh of the same extents on the same vehicles; the "
    "cuboid fills the box and is net of the random mesh beside the judge's own row. Compare rows within a "
    "column: camera is judged in the picture's plane, the others in the bird's-eye view, and each column has "
    "the vehicles that its detector finds clean.";

/// The cell's row, if it has numbers.
const json* find(const json& table, const std::string& source, const std::string& target) {
  for (const json& row : table.at("rows"))
    if (row.at("source") == source && row.at("target") == target) return &row;
  return nullptr;
}

std::vector<std::string> each_once(const json& table, const char* key) {
  std::vector<std::string> names;
  for (const json& row : table.at("rows"))
    if (const auto name = row.at(key).get<std::string>();
        std::find(names.begin(), names.end(), name) == names.end())
      names.push_back(name);
  return names;
}

Interval interval_from(const json& value) {
  return {value.at("value"), value.at("low"), value.at("high")};
}

/// "8.6; +7.1 (+0.0 to +17.5)"
std::string cell_text(const json& values, const std::string& key) {
  if (!values.contains(key)) return "–";
  std::string text = fmt::format("{:.1f}", 100 * values.at(key).at("value").get<double>());
  if (!values.contains("net_" + key)) return text;
  const Interval net = interval_from(values.at("net_" + key));
  text += fmt::format("; {:+.1f} ({:+.1f} to {:+.1f})", 100 * net.value, 100 * net.low, 100 * net.high);
  for (std::size_t at; (at = text.find('-')) != std::string::npos;) text.replace(at, 1, "−");
  // A sign would say more of a zero than is known.
  for (const char* zero : {"+0.0", "−0.0"})
    for (std::size_t at; (at = text.find(zero)) != std::string::npos;)
      text.replace(at, std::string(zero).size(), "0.0");
  return text;
}

}  // namespace

const std::vector<std::string>& fusion_detectors() {
  static const std::vector<std::string> all = {"lidar", "camera", "painted", "fusion", "late"};
  return all;
}

const std::vector<std::string>& fused_detectors() {
  static const std::vector<std::string> fused = {"painted", "fusion", "late"};
  return fused;
}

Attacked through_all(const std::string& detector) {
  return {detector, detector == "lidar" ? "lidar" : detector == "camera" ? "image" : "both"};
}

std::string cell_case(const std::string& rig, const Attacked& attacked, const std::string& judge) {
  if (rig == "real") return fmt::format("evaluations/{}--on--real-{}", attacked.run("kitti64"), judge);
  const std::string own = "evaluations/" + attacked.run(rig);
  return attacked.detector == judge ? own : own + "--on--" + through_all(judge).run(rig);
}

Table fusions_table(CaseList& list, const std::string& rig) {
  Table table{rig == "xenith" ? "fusions-xenith" : "fusions",
              std::string("Which fusion is weak where, ") + (rig == "xenith" ? "Xenith rig" : "KITTI rig"),
              kNote,
              kCell,
              {},
              true};
  const auto run = [&](const Attacked& one) { return list.attack(rig, one.detector, one.target); };
  add_rows(table, rig, list.quick(), [&](const Attacked& one, const std::string& judge) {
    const Attacked own = through_all(judge);
    if (one.detector != judge) return list.transfer(run(one), run(own));
    const bool all = one.target == own.target;
    return list.evaluate(run(one), all, all && judge == "fusion");
  });
  return table;
}

Table fusions_on_real(CaseList& list) {
  Table table{
      "fusions-real",
      "Which fusion is weak where, real KITTI frames",
      std::string("Learned on generated frames of the KITTI rig, judged on all usable vehicles of the "
                  "given ones. ") +
          kNote,
      kCell,
      {},
      true};
  add_rows(table, "real", list.quick(), [&](const Attacked& one, const std::string& judge) {
    const Attacked own = through_all(judge);
    return list.on_real(list.attack("kitti64", one.detector, one.target), judge,
                        one.detector == judge && one.target == own.target);
  });
  return table;
}

std::string matrix_markdown(const json& table) {
  const auto sources = each_once(table, "source"), targets = each_once(table, "target");
  std::string text = fmt::format("## {}: {}\n\n{}\n\n", table.at("name").get<std::string>(),
                                 table.at("title").get<std::string>(), table.at("note").get<std::string>());
  std::string head = " |", rule = "|---|";
  for (const std::string& target : targets) head += " " + target + " |", rule += "---|";
  for (const json& column : table.at("columns")) {
    const auto key = column.at("key").get<std::string>(), title = column.at("title").get<std::string>();
    if (key.starts_with("net")) continue;
    text +=
        fmt::format("| {}, %{}{}\n{}\n", title, key == "fp_asr" ? "" : "; net, points (95 %)", head, rule);
    for (const std::string& source : sources) {
      text += "| " + source + " |";
      for (const std::string& target : targets) {
        const json* row = find(table, source, target);
        const std::string cell = row ? cell_text(row->at("values"), key) : "–";
        text += source.starts_with(target + ",") ? " **" + cell + "** |" : " " + cell + " |";
      }
      text += "\n";
    }
    text += "\n";
  }
  text += "| vehicles found clean at IoU 0.7 |" + head.substr(2) + "\n" + rule + "\n| in frames |";
  for (const std::string& target : targets) {
    std::string counted = "–";
    for (const json& row : table.at("rows"))
      if (row.at("target") == target && row.contains("vehicles"))
        counted = fmt::format("{} in {}", row.at("vehicles").get<int>(), row.at("frames").get<int>());
    text += " " + counted + " |";
  }
  text += "\n\n";
  for (const json& row : table.at("rows"))
    for (const char* key : {"note", "error"})
      if (row.contains(key))
        text += fmt::format("- {}: {}\n", row.at("label").get<std::string>(), row.at(key).get<std::string>());
  return text + "\n";
}

}  // namespace mirage::paper
