// The experiments of Tu et al. (CoRL 2021) and our own, as a list: the commands of mirage that each needs,
// and the rows and columns that they fill. experiments.toml has the rows and what the paper printed, and the
// detectors of the matrices.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "attack/attack_settings.h"
#include "base/fields.h"

namespace mirage::paper {

/// Half lengths L of the box in figure 4, m; 0.8 is the default of every other table.
inline constexpr std::array kBoxSizes = {0.2, 0.4, 0.6, 0.8, 1.0};

struct ReproduceSettings {
  std::string what = "all";
  std::filesystem::path out;
  std::filesystem::path kitti64, xenith, real;  ///< data sets; the first two empty: generated in OUT/data
  int frames = 60;                              ///< generated frames of a rig
  int judge_frames =
      0;  ///< others, on all of whose vehicles attacks are judged; 0: on a run's held-back ones
  /// Rows of the tables by their evaluations' folders (OUT/evaluations/NAME), and the cases that these need;
  /// empty: all.
  std::vector<std::string> only;
  int iterations = AttackSettings().iterations;
  int random_meshes = 1;  ///< of the random baseline, pooled
  int seeds = 1;     ///< runs of each attack, of the seeds seed, seed + 1, …; each splits the frames anew
  int pictures = 3;  ///< of each attack that has pictures
  std::uint64_t seed = 0;
  int threads = 0;
  bool quick = false, quiet = false;
};

/// One command of mirage and its folder.
struct Case {
  enum class Kind { generate, attack, evaluate, detect };
  std::string name;  ///< folder under OUT: "runs/kitti64-fusion-both"
  Kind kind = Kind::attack;
  NamedSettings settings;  ///< without out, threads, quiet and those in `needs`
  /// Settings that name folders of earlier cases, with those cases' names; an evaluation's first is its run.
  std::vector<std::pair<std::string, std::string>> needs;

  /// The setting, or `otherwise`.
  std::string setting(const std::string& key, const std::string& otherwise = "") const;
  /// The settings with the folders of the cases that it needs.
  NamedSettings settings_in(const std::filesystem::path& out) const;
  /// Of an evaluation: the run whose mesh is judged, and the run whose hosts carry it.
  const std::string& run() const { return needs.front().second; }
  const std::string& hosts_of() const;
};

/// The commands that run them.
constexpr auto words_of(Case::Kind) {
  return std::to_array<const char*>({"generate", "attack", "evaluate", "detect"});
}

/// A column: a quantity with its interval.
struct Column {
  std::string key, title;
};

struct Row {
  std::string label, rig;
  std::string evaluation;               ///< case; empty for none
  std::string mesh;                     ///< empty: the learned one; a control's word, or "none": as recorded
  bool image = false;                   ///< an experiment on the image: void if the detector ignores it
  std::string detection;                ///< case of the clean AP; empty for none
  std::string source, target;           ///< table3, fusions: who learned the mesh, who is attacked
  double size = 0;                      ///< fig4: L, m
  std::map<std::string, double> paper;  ///< key of a column to the printed number, per cent
};

struct Table {
  std::string name, title, note;
  std::vector<Column> columns;
  std::vector<Row> rows;
  bool matrix = false;  ///< shown by source and target, a matrix a quantity
};

struct Experiments {
  std::vector<Table> tables;
  /// In the order to run: each after the cases that it needs, table by table; all of one seed before the
  /// next.
  std::vector<Case> cases;
  int seeds = 1;
  const Case& at(const std::string& name) const;
  /// Adds the case and all cases that it needs; nothing for an empty name.
  void add_closure(const std::string& name, std::set<std::string>& names) const;
};

/// The name of an attack's or evaluation's repetition from another seed; number 0 is the case itself.
std::string repetition(const std::string& name, int number);
bool is_repetition(const std::string& name);

/// The folder of a rig's data: the user's, or OUT/data/RIG.
std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig);

/// How an attack differs from the tables' usual attack.
struct Variant {
  double size = 0;           ///< L, m; 0: the default box
  std::string defense = {};  ///< word of --defense; empty: none
  std::string parts = {};    ///< word of --parts; empty: shape and texture
  bool solid = false;        ///< without --free: a mesh that can be printed
};

/// With a box of half length `size`, m; 0.8 is the default one's.
inline Variant of_size(double size) {
  return {.size = size == 0.8 ? 0 : size};
}

/// Folder of an attack's run, and of its evaluation on its own hosts: "kitti64-fusion-both-size0.2",
/// "kitti64-fusion-both-jpeg50". `attack`: "RIG-DETECTOR-TARGET".
std::string run_name(const std::string& attack, const Variant& variant = {});

/// Fewer frames and iterations, each unless the user asked for a number, and some of many similar rows: every
/// kind of experiment runs in minutes, and its figures say nothing.
void make_quick(ReproduceSettings& settings, bool fewer_frames = true, bool fewer_iterations = true);

/// The experiments that `settings.what` names. InputError for another word. Each attack and evaluation is
/// repeated for settings.seeds − 1 more seeds, seed by seed: learned anew, on another split of the frames.
Experiments experiments(const ReproduceSettings& settings);

}  // namespace mirage::paper
