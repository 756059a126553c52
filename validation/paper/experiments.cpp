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

namespace mirage::paper {
namespace {

using Strings = std::vector<std::string>;

Strings words_in(const std::string& text) {
  std::istringstream words(text);
  return {std::istream_iterator<std::string>(words), {}};
}

/// Whether what a defence (a word of --defense, or several) does is about the picture. It is not: adversarial
/// training, its control on roofs and the sweep's bodies.
bool concerns_picture(const std::string& text) {
  const Defense defense = read_defense(text);
  const std::set<std::string> of_both = {"", "adversarial", "roof-objects", kCeiling};
  return !of_both.contains(defense.weights) ||
         std::any_of(defense.around.begin(), defense.around.end(),
                     [](const std::string& word) { return word != kShadows && ceiling_height(word) == 0; });
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
  const std::string name = fields.text("attack"), onto = text("on");
  row.mesh = text("mesh");
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
  row.image = row.mesh.empty() && onto.empty() &&
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

/// The matrix on frames of a rig: one row for each mesh and judge. On "real" ones what was learned on kitti64
/// is judged on all usable vehicles.
void add_matrix(Table& table, const std::string& rig, const Strings& detectors, CaseList& list) {
  const auto run = [&](const std::string& detector, const std::string& target) {
    return list.attack(rig == "real" ? "kitti64" : rig, detector, target);
  };
  const auto add = [&](const std::string& source, const std::string& detector, const std::string& target,
                       const std::string& judge) {
    const bool own = detector == judge;
    const std::string all = all_sensors(judge), learned = run(detector, target);
    Row& row = table.rows.emplace_back();
    row.label = source + " → " + judge;
    row.rig = rig;
    row.source = source;
    row.target = judge;
    row.evaluation = rig == "real" ? list.on_real(learned, judge, own && target == all)
                     : own         ? list.evaluate(learned)
                                   : list.transfer(learned, run(judge, all));
    row.image = own && target == "image";
  };
  for (const std::string& detector : detectors)
    for (const std::string target : {"image", "lidar", "both"})
      if (all_sensors(detector) == "both" || all_sensors(detector) == target)
        for (const std::string& judge : detectors)
          add(detector + ", " + target_title(target), detector, target, judge);
  for (const std::string& judge : detectors) {
    add("no learning: cuboid", judge, all_sensors(judge), judge);
    table.rows.back().mesh = "cuboid";
    table.rows.back().image = false;
  }
}

/// Reads experiments.toml.
class Tables {
 public:
  Tables(const ReproduceSettings& settings, CaseList& list) : settings_(settings), list_(list) {}

  std::vector<Table> read() {
    std::vector<Table> tables;
    for (const nlohmann::json& one : whole_.at("table")) {
      Table table =
          read_table(ConfigTable::of(file_, "table", one), one.value("rows", nlohmann::json::array()));
      if (!table.rows.empty()) tables.push_back(std::move(table));
    }
    return tables;
  }

 private:
  bool is_there(const std::string& rig) const { return rig != "real" || !settings_.real.empty(); }

  /// Without rows where it is not asked for.
  Table read_table(ConfigTable fields, const nlohmann::json& rows) {
    const auto text = [&](const char* key) { return fields.has(key) ? fields.text(key) : std::string(); };
    Table table{fields.text("name"), fields.text("title"), text("note"), {}, {}};
    const std::string what = text("what"), rig = text("matrix");
    table.matrix = !rig.empty();
    ConfigTable shared = ConfigTable::of(file_, "matrix", whole_.at("matrix"));
    ConfigTable titles =
        table.matrix ? shared.table("titles") : ConfigTable::of(file_, "titles", whole_.at("titles"));
    const Strings columns = words_in(table.matrix ? shared.text("columns") : fields.text("columns")),
                  runs = words_in(text("runs"));
    for (const std::string& key : columns) table.columns.push_back({key, titles.text(key)});
    fields.skip("rows");
    fields.check_all_known();
    if (settings_.what != "all" && settings_.what != (what.empty() ? table.name : what)) return table;
    if (table.matrix) {
      table.note += shared.text("note");
      if (is_there(rig))
        add_matrix(table, rig, words_in(shared.text(settings_.quick ? "quick" : "detectors")), list_);
      return table;
    }
    for (const std::string& name : runs)
      if (is_there(AttackName(name).rig)) list_.evaluate(attack(list_, name));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      ConfigTable row = ConfigTable::of(file_, fmt::format("table {}, rows[{}]", table.name, i), rows[i]);
      const bool left_out = row.has("quick") && row.text("quick") == "left out" && settings_.quick;
      if (!left_out && is_there(AttackName(row.text(row.has("on") ? "on" : "attack")).rig))
        table.rows.push_back(read_row(std::move(row), table, list_));
    }
    return table;
  }

  const std::filesystem::path file_ = shipped_file("validation/paper/experiments.toml");
  const nlohmann::json whole_ = read_toml(file_);
  const ReproduceSettings& settings_;
  CaseList& list_;
};

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
  experiments.tables = Tables(settings, list).read();
  experiments.cases = std::move(list.cases);
  if (!settings.only.empty()) leave_out_others(experiments, settings.only);
  repeat(experiments, settings);
  return experiments;
}

}  // namespace mirage::paper
