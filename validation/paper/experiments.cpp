#include "validation/paper/experiments.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <iterator>
#include <set>
#include <sstream>

#include "base/config.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/words.h"
#include "detection/detector_settings.h"
#include "validation/paper/cases.h"
#include "validation/paper/evidence.h"

namespace mirage::paper {
namespace {

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

std::string words(const Attacked& attacked) {
  return attacked.detector + ", " + target_title(attacked.target);
}

/// One row for each mesh and judge; `judged` names, and adds, the evaluation.
template <class Judged>
void add_rows(Table& table, const std::string& rig, bool quick, const Judged& judged) {
  std::set<std::string> judges;
  for (const Attacked& attacked : attacks(quick)) judges.insert(attacked.detector);
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
  for (const Attacked& attacked : attacks(quick))
    for (const std::string& judge : fusion_detectors())
      if (judges.contains(judge))
        add(words(attacked), judge, judged(attacked, judge))->image =
            attacked.target == "image" && attacked.detector == judge;
  for (const std::string& judge : fusion_detectors())
    if (judges.contains(judge)) add(kCuboid, judge, judged(through_all(judge), judge))->cuboid = true;
}

constexpr const char* kNote =
    "Rows: against which detector, and through which of its sensors, the mesh was learned; columns: who "
    "judges it, on the same vehicles. Net: less a random mesh of the same extents on the same vehicles; the "
    "cuboid fills the box and is net of the random mesh beside the judge's own row. Compare rows within a "
    "column: camera is judged in the picture's plane, the others in the bird's-eye view, and each column has "
    "the vehicles that its detector finds clean.";

}  // namespace

const std::vector<std::string>& fusion_detectors() {
  static const std::vector<std::string> all = {"lidar", "camera", "painted", "fusion", "refined", "late"};
  return all;
}

const std::vector<std::string>& fused_detectors() {
  static const std::vector<std::string> fused = {"painted", "fusion", "refined", "late"};
  return fused;
}

Attacked through_all(const std::string& detector) {
  return {detector, all_sensors(detector)};
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
  const auto run = [&](const Attacked& attacked) {
    return list.attack(rig, attacked.detector, attacked.target);
  };
  add_rows(table, rig, list.quick(), [&](const Attacked& attacked, const std::string& judge) {
    if (attacked.detector != judge) return list.transfer(run(attacked), run(through_all(judge)));
    return list.evaluate(run(attacked));
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
  add_rows(table, "real", list.quick(), [&](const Attacked& attacked, const std::string& judge) {
    const Attacked own = through_all(judge);
    return list.on_real(list.attack("kitti64", attacked.detector, attacked.target), judge,
                        attacked.detector == judge && attacked.target == own.target);
  });
  return table;
}

namespace {

using Strings = std::vector<std::string>;

Strings words_in(const std::string& text) {
  std::istringstream words(text);
  return {std::istream_iterator<std::string>(words), {}};
}

/// An attack by its run's name without what varies: "kitti64-fusion-both".
struct AttackName {
  std::string rig, detector, target;
  explicit AttackName(const std::string& name) {
    const std::size_t first = name.find('-'), second = name.find('-', first + 1);
    rig = name.substr(0, first);
    detector = name.substr(first + 1, second - first - 1);
    target = name.substr(second + 1);
  }
};

std::string attack(CaseList& list, const std::string& name, const Variant& variant = {}) {
  const AttackName of(name);
  return list.attack(of.rig, of.detector, of.target, variant);
}

/// A row of experiments.toml.
Row read_row(ConfigTable fields, const Table& table, CaseList& list) {
  Row row;
  const auto text = [&](const char* key) { return fields.has(key) ? fields.text(key) : std::string(); };
  const std::string name = fields.text("attack"), onto = text("on"), mesh = text("mesh");
  Variant variant{.defense = text("defense"), .parts = text("parts")};
  if (fields.has("size")) {
    row.size = fields.number("size", 0.05, 10);
    variant.size = of_size(row.size).size;
  }
  const std::string run = attack(list, name, variant);
  const AttackName attacked(name), judged(onto.empty() ? name : onto);
  row.evaluation = onto.empty() ? list.evaluate(run) : list.transfer(run, attack(list, onto));
  row.rig = judged.rig;
  row.source = text("source");
  row.target = text("target");
  row.label = fields.has("label") ? fields.text("label") : row.source + " → " + row.target;
  row.random = mesh == "start";
  row.sized = mesh == "sized";
  row.clean = mesh == "none";
  row.image = mesh.empty() && onto.empty() &&
              (attacked.target == "image" || (!variant.defense.empty() && concerns_picture(variant.defense)));
  for (const Column& column : table.columns)
    if (column.key == "ap70") row.detection = list.detect(attacked.rig, attacked.detector, variant.defense);
  if (fields.has("paper")) {
    ConfigTable paper = fields.table("paper");
    for (const Column& column : table.columns)
      if (paper.has(column.key)) row.paper[column.key] = paper.number(column.key, 0, 100);
    paper.check_all_known();
  }
  fields.check_all_known();
  return row;
}

/// A table of experiments.toml; without rows where it is not asked for.
Table read_table(ConfigTable fields, const nlohmann::json& rows, const std::filesystem::path& file,
                 ConfigTable& titles, const ReproduceSettings& settings, CaseList& list) {
  Table table{fields.text("name"), fields.text("title"), fields.text("note"), {}, {}};
  const std::string what = fields.has("what") ? fields.text("what") : table.name;
  for (const std::string& key : words_in(fields.text("columns")))
    table.columns.push_back({key, titles.text(key)});
  const Strings runs = words_in(fields.has("runs") ? fields.text("runs") : "");
  fields.skip("rows");
  fields.check_all_known();
  if (settings.what != "all" && settings.what != what) return table;
  const auto is_there = [&](const std::string& name) {
    return AttackName(name).rig != "real" || !settings.real.empty();
  };
  for (const std::string& name : runs)
    if (is_there(name)) list.evaluate(attack(list, name));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    ConfigTable row = ConfigTable::of(file, fmt::format("table {}, rows[{}]", table.name, i), rows[i]);
    const bool left_out = row.has("quick") && row.text("quick") == "left out" && settings.quick;
    if (!left_out && is_there(row.has("on") ? row.text("on") : row.text("attack")))
      table.rows.push_back(read_row(std::move(row), table, list));
  }
  return table;
}

std::vector<Table> read_tables(const ReproduceSettings& settings, CaseList& list) {
  const std::filesystem::path file = shipped_file("validation/paper/experiments.toml");
  const nlohmann::json whole = read_toml(file);
  ConfigTable titles = ConfigTable::of(file, "titles", whole.at("titles"));
  std::vector<Table> tables;
  for (const nlohmann::json& one : whole.at("table")) {
    Table table =
        read_table(ConfigTable::of(file, "table", one), one.at("rows"), file, titles, settings, list);
    if (!table.rows.empty()) tables.push_back(std::move(table));
  }
  return tables;
}

const std::string kEvaluations = "evaluations/";

/// Keeps the rows of these evaluations, and the cases that they need.
void leave_out_others(Experiments& experiments, const Strings& only) {
  std::set<std::string> wanted, met, needed;
  for (const std::string& name : only) wanted.insert(kEvaluations + name);
  const std::function<void(const std::string&)> need = [&](const std::string& name) {
    if (name.empty() || !needed.insert(name).second) return;
    for (const auto& [folder, before] : experiments.at(name).needs) need(before);
  };
  for (Table& table : experiments.tables) {
    std::erase_if(table.rows, [&](const Row& row) { return !wanted.contains(row.evaluation); });
    for (const Row& row : table.rows) {
      met.insert(row.evaluation);
      need(row.evaluation);
      need(row.detection);
    }
  }
  for (const std::string& name : wanted)
    if (!met.contains(name))
      throw FieldError("only", name.substr(kEvaluations.size()), "is no evaluation of what is asked for",
                       "use names such as kitti64-fusion-both, the folders in OUT/evaluations");
  std::erase_if(experiments.tables, [](const Table& table) { return table.rows.empty(); });
  std::erase_if(experiments.cases, [&](const Case& one) { return !needed.contains(one.name); });
}

}  // namespace

bool concerns_picture(const std::string& text) {
  const Defense defense = read_defense(text);
  const std::set<std::string> of_both = {"", "adversarial", "roof-objects", kCeiling};
  return !of_both.contains(defense.weights) ||
         std::any_of(defense.around.begin(), defense.around.end(),
                     [](const std::string& word) { return word != kShadows && ceiling_height(word) == 0; });
}

void make_quick(ReproduceSettings& settings) {
  const ReproduceSettings standing;
  if (settings.frames == standing.frames) settings.frames = 8;
  if (settings.iterations == standing.iterations) settings.iterations = 4;
  settings.quick = true;
}

Experiments experiments(const ReproduceSettings& settings) {
  const Strings words = {"table1", "table2", "fig3",    "fig4",           "table3",
                         "table4", "parts",  "fusions", "fusions-xenith", "all"};
  if (std::find(words.begin(), words.end(), settings.what) == words.end())
    throw InputError("reproduce", settings.what, "no such table or figure", use_one_of(settings.what, words));
  CaseList list(settings);
  Experiments experiments;
  experiments.tables = read_tables(settings, list);
  const bool all = settings.what == "all", real = !settings.real.empty();
  const auto wanted = [&](const char* name) { return all || settings.what == name; };
  if (wanted("fusions")) experiments.tables.push_back(fusions_table(list, "kitti64"));
  if (wanted("fusions") && real) experiments.tables.push_back(fusions_on_real(list));
  if (wanted("fusions-xenith")) experiments.tables.push_back(fusions_table(list, "xenith"));
  experiments.cases = std::move(list.cases);
  if (!settings.only.empty()) leave_out_others(experiments, settings.only);
  repeat(experiments, settings);
  return experiments;
}

}  // namespace mirage::paper
