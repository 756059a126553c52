// What an experiment is made of: the commands that it needs, and the rows and columns that they fill
// (experiments.h has the list).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "attack/attack_settings.h"
#include "base/field_text.h"

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
  /// Rows of the tables by their evaluations' folders (OUT/evaluations/NAME), and what these need; empty:
  /// all.
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
  /// The settings that are folders of cases that come before, and the names of those; an evaluation's first
  /// is its run.
  std::vector<std::pair<std::string, std::string>> needs;

  /// The setting, or `otherwise`.
  std::string setting(const std::string& key, const std::string& otherwise = "") const;
  /// With the folders of the cases that it needs.
  NamedSettings settings_in(const std::filesystem::path& out) const;
  /// Of an evaluation: the run whose mesh is judged, and the run on whose hosts.
  const std::string& run() const { return needs.front().second; }
  const std::string& hosts_of() const;
};

/// The commands that run them.
constexpr auto words_of(Case::Kind) {
  return std::to_array<const char*>({"generate", "attack", "evaluate", "detect"});
}

/// A column: a quantity with its interval (tables.h).
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
  /// In the order to run: each after what it needs, table by table; and all of a seed before the next.
  std::vector<Case> cases;
  int seeds = 1;
  const Case& at(const std::string& name) const;
};

// The same experiments again from other seeds: each attack is learned anew, on another split of the frames,
// and judged beside the first one.

/// The name of an attack's or evaluation's repetition; number 0 is the case itself.
std::string repetition(const std::string& name, int number);
bool is_repetition(const std::string& name);
/// Appends settings.seeds − 1 repetitions of every attack and evaluation, a whole seed after the other.
void repeat(Experiments& experiments, const ReproduceSettings& settings);

/// The folder of a rig's data: what was given, or OUT/data/RIG.
std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig);

// The commands that the tables' rows need, each once: two rows that name the same experiment share its case.

/// A --target as tables say it: "LiDAR", "image", "both".
inline std::string target_title(const std::string& target) {
  return target == "lidar" ? "LiDAR" : target;
}

/// The --target that reaches all sensors of a detector.
inline std::string all_sensors(const std::string& detector) {
  return detector == "lidar" ? "lidar" : detector == "camera" ? "image" : "both";
}

/// How an attack departs from the tables' standing one.
struct Variant {
  double size = 0;           ///< L, m; 0: the default box
  std::string defense = {};  ///< word of --defense; empty: none
  std::string parts = {};    ///< word of --parts; empty: shape and texture
};

/// With a box of half length `size`, m; 0.8 is the default one's.
inline Variant of_size(double size) {
  return {.size = size == 0.8 ? 0 : size};
}

/// Folder of an attack's run, and of its evaluation on its own hosts: "kitti64-fusion-both-size0.2",
/// "kitti64-fusion-both-jpeg50".
std::string run_name(const std::string& rig, const std::string& detector, const std::string& target,
                     const Variant& variant = {});

/// Collects the cases that the rows name. Each function returns the case's name.
class CaseList {
 public:
  explicit CaseList(const ReproduceSettings& settings) : settings_(settings) {}

  std::string attack(const std::string& rig, const std::string& detector, const std::string& target,
                     const Variant& variant = {});

  /// Of a run on its own held-back hosts (or all of the frames that are there to judge), beside random meshes
  /// of its size. The usual attack on a detector, through all of its sensors, stands also beside the paper's
  /// random meshes and beside the cuboid that fills the box; that on `fusion` has pictures.
  std::string evaluate(const std::string& run);

  /// Of a run on the held-back hosts, data and detector of another, beside random meshes of its size.
  std::string transfer(const std::string& from, const std::string& onto);

  /// Of a run on all usable vehicles of the user's frames, judged by the detector, beside random meshes of
  /// its size; with `cuboid` beside that, too.
  std::string on_real(const std::string& run, const std::string& detector, bool cuboid);

  std::string detect(const std::string& rig, const std::string& detector, const std::string& defense);

  bool quick() const { return settings_.quick; }

  std::vector<Case> cases;

 private:
  /// The evaluation "evaluations/NAME" of a run on its own held-back hosts, beside the baselines.
  Case judging(const std::string& name, const std::string& run, const std::string& baselines) const;

  /// Lets the evaluation judge on frames made for that, if any are asked for, in place of the hosts that the
  /// run has held back.
  void add_hosts(Case& command, const std::string& run);

  /// Lets the case read the rig's data: the user's, or those of a case that makes them.
  void add_data(Case& command, const std::string& rig);

  /// The case of that name, which is there.
  const Case& at(const std::string& name) const;

  /// Tables share cases: one of a name that is there already must be the same.
  std::string add(Case command);

  const ReproduceSettings& settings_;
};

}  // namespace mirage::paper
