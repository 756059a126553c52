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
#include "base/named_settings.h"

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

/// A column: a quantity with its interval (tables.h computes it).
struct Column {
  std::string key, title;
};

struct Row {
  std::string label, rig;
  std::string evaluation;               ///< case; empty for none
  bool random = false;                  ///< the evaluation's random meshes instead of the learned one
  bool sized = false;                   ///< its random meshes of the learned one's size
  bool cuboid = false;                  ///< its cuboids that fill the box
  bool image = false;                   ///< an experiment on the image: void if the detector ignores it
  bool clean = false;                   ///< the frames as recorded (recall curves)
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

/// The folder of a rig's data: what was given, or OUT/data/RIG.
std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig);

}  // namespace mirage::paper
