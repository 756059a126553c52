#include "validation/paper/experiments.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "attack/objective.h"
#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "detection/detector_settings.h"

namespace mirage::paper {

std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig) {
  const auto& chosen = rig == "real" ? settings.real : rig == "xenith" ? settings.xenith : settings.kitti64;
  return chosen.empty() ? settings.out / "data" / rig : chosen;
}

std::string Case::setting(const std::string& key, const std::string& otherwise) const {
  const auto entry = settings.find(key);
  return entry == settings.end() ? otherwise : entry->second;
}

NamedSettings Case::settings_in(const std::filesystem::path& out) const {
  NamedSettings all = settings;
  for (const auto& [folder, need] : needs) all[folder] = (out / need).string();
  return all;
}

const std::string& Case::hosts_of() const {
  const auto other =
      std::find_if(needs.begin(), needs.end(), [](const auto& need) { return need.first == "hosts_of"; });
  return other == needs.end() ? run() : other->second;
}

const Case& Experiments::at(const std::string& name) const {
  const auto match = std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
  if (match == cases.end()) throw InputError("experiments", name, "no such case", "name one of the list");
  return *match;
}

void Experiments::add_closure(const std::string& name, std::set<std::string>& names) const {
  if (name.empty() || !names.insert(name).second) return;
  for (const auto& [folder, need] : at(name).needs) add_closure(need, names);
}

namespace {

/// A defence at the end of a case's name: "jpeg:50" as "-jpeg50", "a+b" as "-a-b"; empty for none.
std::string defense_suffix(std::string defense) {
  if (defense.empty()) return "";
  std::erase(defense, ':');
  std::replace(defense.begin(), defense.end(), '+', '-');
  return "-" + defense;
}

/// "fusion-both" of "runs/kitti64-fusion-both".
std::string last_part(const std::string& name) {
  return name.substr(name.find('/') + 1);
}

/// An attack by its run's name without what varies: "kitti64-fusion-both".
struct AttackName {
  std::string text, rig, detector, target;
  explicit AttackName(const std::string& name) : text(name) {
    const std::size_t first = name.find('-'), second = name.find('-', first + 1);
    rig = name.substr(0, first);
    detector = name.substr(first + 1, second - first - 1);
    target = name.substr(second + 1);
  }
};

/// Through all sensors of the detector.
AttackName through_all(const std::string& rig, const std::string& detector) {
  const char* all = detector == "lidar" ? "lidar" : detector == "camera" ? "image" : "both";
  return AttackName(rig + "-" + detector + "-" + all);
}

/// Collects the cases that the rows name, each once: two rows that name the same experiment share its case.
/// Each function returns the case's name.
class CaseList {
 public:
  explicit CaseList(const ReproduceSettings& settings) : settings_(settings) {}

  std::string attack(const AttackName& name, const Variant& variant = {}) {
    const AttackSettings recipe;
    Case command{"runs/" + run_name(name.text, variant),
                 Case::Kind::attack,
                 {{"detector", name.detector},
                  {"target", name.target},
                  {"iterations", std::to_string(settings_.iterations)},
                  {"batch", std::to_string(recipe.batch)},
                  {"vertex_rate", fmt::format("{}", recipe.vertex_rate)},
                  {"texel_rate", fmt::format("{}", recipe.texel_rate)},
                  {"fp_top_k", std::to_string(recipe.objective.fp_top_k)},
                  {"lidar_gradient", to_word(LidarGradient::silhouette)},
                  {"free", variant.solid ? "false" : "true"},  // the paper's mesh is no solid
                  {"seed", std::to_string(settings_.seed)}},
                 {}};
    if (variant.size > 0) command.settings["size"] = fmt::format("{:.1f}", variant.size);
    if (!variant.parts.empty()) command.settings["parts"] = variant.parts;
    if (!variant.defense.empty()) command.settings["defense"] = variant.defense;
    add_data(command, name.rig);
    return add(command);
  }

  /// A run on its own held-back hosts (or all of the frames that are there to judge), beside random meshes of
  /// its size. The usual attack on a detector, through all of its sensors, stands also beside the paper's
  /// random meshes and beside the cuboid that fills the box; that on `fusion` has pictures.
  std::string evaluate(const std::string& run) {
    const std::string name = last_part(run);
    const AttackName attacked(name);
    const bool usual = through_all(attacked.rig, attacked.detector).text == name;
    Case command = evaluation_case(name, run, usual ? "start,sized,cuboid" : "sized");
    add_hosts(command, attacked.rig);
    if (usual && attacked.detector == "fusion")
      command.settings["pictures"] = std::to_string(settings_.pictures);
    return add(command);
  }

  /// A run on the held-back hosts, data and detector of another, beside random meshes of its size.
  std::string transfer(const std::string& from, const std::string& onto) {
    const AttackName there(last_part(onto));
    Case command = evaluation_case(last_part(from) + "--on--" + there.text, from, "sized");
    if (settings_.judge_frames == 0) {
      command.needs.emplace_back("hosts_of", onto);
      return add(command);
    }
    command.settings["detector"] = there.detector;
    add_hosts(command, there.rig);
    return add(command);
  }

  /// A run on all usable vehicles of the user's frames, judged by the detector, beside random meshes of its
  /// size; with `cuboid` beside that, too.
  std::string on_real(const std::string& run, const std::string& detector, bool cuboid) {
    Case command =
        evaluation_case(last_part(run) + "--on--real-" + detector, run, cuboid ? "sized,cuboid" : "sized");
    command.settings["detector"] = detector;
    add_data(command, "real");
    return add(command);
  }

  std::string detect(const AttackName& of, const std::string& defense) {
    Case command{fmt::format("detect/{}-{}{}", of.rig, of.detector, defense_suffix(defense)),
                 Case::Kind::detect,
                 {{"detector", of.detector}},
                 {}};
    if (!defense.empty()) command.settings["defense"] = defense;
    add_data(command, of.rig);
    return add(command);
  }

  std::vector<Case> cases;

 private:
  /// The evaluation "evaluations/NAME" of a run on its own held-back hosts, beside the baselines.
  Case evaluation_case(const std::string& name, const std::string& run, const std::string& baselines) const {
    return {"evaluations/" + name,
            Case::Kind::evaluate,
            {{"random_meshes", std::to_string(settings_.random_meshes)}, {"baseline", baselines}},
            {{"run", run}}};
  }

  std::string generated(const std::string& name, const std::string& rig, int frames, const char* seed) {
    return add({"data/" + name,
                Case::Kind::generate,
                {{"rig", rig}, {"frames", std::to_string(frames)}, {"seed", seed}},
                {}});
  }

  /// Lets the evaluation judge on extra frames, if any are asked for, instead of the hosts that the run has
  /// held back.
  void add_hosts(Case& command, const std::string& rig) {
    if (settings_.judge_frames > 0 && rig != "real")
      command.needs.emplace_back("data", generated(rig + "-judge", rig, settings_.judge_frames, "23"));
  }

  /// Lets the case read the rig's data: the user's, or those of a case that makes them.
  void add_data(Case& command, const std::string& rig) {
    if (rig == "real" || !(rig == "kitti64" ? settings_.kitti64 : settings_.xenith).empty())
      command.settings["data"] = data_folder(settings_, rig).string();
    else
      command.needs.emplace_back("data", generated(rig, rig, settings_.frames, "3"));
  }

  /// A case whose name exists already must be the same.
  std::string add(const Case& command) {
    const auto known = std::ranges::find(cases, command.name, &Case::name);
    if (known == cases.end())
      cases.push_back(command);
    else if (known->settings != command.settings || known->needs != command.needs)
      throw std::logic_error("two cases named " + command.name);
    return command.name;
  }

  const ReproduceSettings& settings_;
};

using Strings = std::vector<std::string>;

Strings words_in(const std::string& text) {
  const auto words = split(text, " ");
  return {words.begin(), words.end()};
}

/// Whether a defence (one or several words of --defense) works on the picture. These do not: adversarial
/// training, its control on roofs, and the sweep's bodies.
bool concerns_picture(const std::string& text) {
  const Defense defense = read_defense(text);
  const std::set<std::string> of_both = {"", "adversarial", "roof-objects", kCeiling};
  return !of_both.contains(defense.weights) ||
         std::any_of(defense.around.begin(), defense.around.end(),
                     [](const std::string& word) { return word != kShadows && ceiling_height(word) == 0; });
}

/// A row of experiments.toml.
Row read_row(ConfigTable fields, const Table& table, CaseList& list) {
  Row row;
  const auto text = [&](const char* key) { return fields.has(key) ? fields.text(key) : std::string(); };
  const std::string name = fields.text("attack"), onto = text("on");
  row.mesh = text("mesh");
  Variant variant{.defense = text("defense"),
                  .parts = text("parts"),
                  .solid = fields.has("solid") && fields.number("solid", 0, 1) == 1};
  if (fields.has("size")) {
    row.size = fields.number("size", 0.05, 10);
    variant.size = of_size(row.size).size;
  }
  const AttackName attacked(name), judged(onto.empty() ? name : onto);
  const std::string run = list.attack(attacked, variant);
  row.evaluation = onto.empty() ? list.evaluate(run) : list.transfer(run, list.attack(judged));
  row.rig = judged.rig;
  row.source = text("source");
  row.target = text("target");
  row.label = fields.has("label") ? fields.text("label") : row.source + " → " + row.target;
  row.image = row.mesh.empty() && onto.empty() &&
              (attacked.target == "image" || (!variant.defense.empty() && concerns_picture(variant.defense)));
  for (const Column& column : table.columns)
    if (column.key == "ap70") row.detection = list.detect(attacked, variant.defense);
  if (fields.has("paper")) {
    ConfigTable paper = fields.table("paper");
    for (const Column& column : table.columns)
      if (paper.has(column.key)) row.paper[column.key] = paper.number(column.key, 0, 100);
    paper.check_all_known();
  }
  fields.check_all_known();
  return row;
}

/// The matrix on frames of a rig: one row for each mesh and judge. On "real" frames, meshes learned on
/// kitti64 are judged on all usable vehicles.
void add_matrix(Table& table, const std::string& rig, const Strings& detectors, CaseList& list) {
  const std::string learned_on = rig == "real" ? "kitti64" : rig;
  const auto add = [&](const std::string& source, const AttackName& attack, const std::string& judge) {
    const AttackName own = through_all(learned_on, judge);
    const std::string learned = list.attack(attack);
    Row& row = table.rows.emplace_back();
    row.label = source + " → " + judge;
    row.rig = rig;
    row.source = source;
    row.target = judge;
    row.evaluation = rig == "real"              ? list.on_real(learned, judge, attack.text == own.text)
                     : attack.detector == judge ? list.evaluate(learned)
                                                : list.transfer(learned, list.attack(own));
    return &row;
  };
  for (const std::string& detector : detectors)
    for (const std::string target : {"image", "lidar", "both"}) {
      const AttackName attack(learned_on + "-" + detector + "-" + target);
      const std::string all = through_all(learned_on, detector).target;
      if (all != "both" && all != target) continue;
      for (const std::string& judge : detectors)
        add(detector + ", " + (target == "lidar" ? "LiDAR" : target), attack, judge)->image =
            detector == judge && target == "image";
    }
  for (const std::string& judge : detectors)
    add("no learning: cuboid", through_all(learned_on, judge), judge)->mesh = "cuboid";
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

  /// Without rows if it is not asked for.
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
      if (is_there(AttackName(name).rig)) list_.evaluate(list_.attack(AttackName(name)));
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
  std::set<std::string> selected, met, needed;
  for (const std::string& name : only) selected.insert(kEvaluations + name);
  for (Table& table : experiments.tables) {
    std::erase_if(table.rows, [&](const Row& row) { return !selected.contains(row.evaluation); });
    for (const Row& row : table.rows) {
      met.insert(row.evaluation);
      experiments.add_closure(row.evaluation, needed);
      experiments.add_closure(row.detection, needed);
    }
  }
  for (const std::string& name : selected)
    if (!met.contains(name))
      throw FieldError("only", name.substr(kEvaluations.size()), "is not an evaluation of what is asked for",
                       "use names such as kitti64-fusion-both, the folders in OUT/evaluations");
  std::erase_if(experiments.tables, [](const Table& table) { return table.rows.empty(); });
  std::erase_if(experiments.cases, [&](const Case& one) { return !needed.contains(one.name); });
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& command, int number, const ReproduceSettings& settings) {
  Case rerun = command;
  rerun.name = repetition(command.name, number);
  if (command.kind == Case::Kind::evaluate)
    for (auto& [folder, need] : rerun.needs)
      if (folder != "data") need = repetition(need, number);
  rerun.settings.erase("pictures");
  rerun.settings["seed"] = std::to_string(settings.seed + static_cast<std::uint64_t>(number));
  return rerun;
}

/// Appends the repetitions.
void repeat(Experiments& experiments, const ReproduceSettings& settings) {
  experiments.seeds = settings.seeds;
  const std::size_t once = experiments.cases.size();
  for (int number = 1; number < settings.seeds; ++number)
    for (std::size_t i = 0; i < once; ++i)
      if (const auto kind = experiments.cases[i].kind;
          kind == Case::Kind::attack || kind == Case::Kind::evaluate)
        experiments.cases.push_back(repeated(experiments.cases[i], number, settings));
}

}  // namespace

std::string run_name(const std::string& attack, const Variant& variant) {
  std::string name = attack;
  if (variant.size > 0) name += fmt::format("-size{:.1f}", variant.size);
  if (!variant.parts.empty()) name += "-" + variant.parts;
  if (variant.solid) name += "-solid";
  return name + defense_suffix(variant.defense);
}

std::string repetition(const std::string& name, int number) {
  return number == 0 ? name : fmt::format("{}{}{}", name, '+', number);
}

bool is_repetition(const std::string& name) {
  return name.find('+') != std::string::npos;
}

void make_quick(ReproduceSettings& settings, bool fewer_frames, bool fewer_iterations) {
  if (fewer_frames) settings.frames = 8;
  if (fewer_iterations) settings.iterations = 4;
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
