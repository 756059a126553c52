// The commands that the tables' rows need, each once: two rows that name the same experiment share its case.
#pragma once

#include <string>
#include <vector>

#include "validation/paper/cases.h"

namespace mirage::paper {

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
