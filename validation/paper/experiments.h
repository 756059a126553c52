// Which fusion is weak where: one object, six detectors, each attacked through each of its sensors and
// through both (modality gating), and every learned mesh judged by all six on the same held-back vehicles.
// Each cell stands net of random meshes of the learned one's extents, so that what is compared is learning
// and not size. Not in the paper, which has one fusion (Tu et al., CoRL 2021, sections 4.2 to 4.4); that
// images are the weak side is its claim, that LiDAR is that of Abdelfattah et al. (arXiv 2303.03470).
//
// What may be compared: rows within a column, whose vehicles are the same, found clean by the same detector
// with the same rule. Between columns only who gains: `camera` finds boxes in the picture and the others in
// the bird's-eye view, an IoU of 0.7 is another demand there, and each detector finds other vehicles clean.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "validation/paper/cases.h"

namespace mirage::paper {

/// Who is attacked, and whose gradient reaches the mesh ("image", "lidar" or "both").
struct Attacked {
  std::string detector, target;
  std::string run(const std::string& rig) const { return run_name(rig, detector, target); }
};

/// The six detectors, in the matrix's order.
const std::vector<std::string>& fusion_detectors();
/// Those that read both sensors: painted, fusion, refined, late.
const std::vector<std::string>& fused_detectors();
/// The attack on the detector through all of its sensors, which gives the vehicles that it judges.
Attacked through_all(const std::string& detector);
/// The case where `judge` judges what was learned on a generated rig; on "real" frames what was learned on
/// kitti64.
std::string cell_case(const std::string& rig, const Attacked& attacked, const std::string& judge);

/// Learned and judged on a generated rig. Quick: lidar, camera and fusion alone.
Table fusions_table(CaseList& list, const std::string& rig);
/// Learned on kitti64, judged on all usable vehicles of the user's frames.
Table fusions_on_real(CaseList& list);

// The experiments of Tu et al. (CoRL 2021) and our own, as a list: which commands of mirage each table needs.
// experiments.toml has the rows and what the paper printed; experiments.h the matrices.

/// Whether what a defence (a word of --defense, or several) does is about the picture. It is not: adversarial
/// training, its control on roofs and the sweep's bodies.
bool concerns_picture(const std::string& defense);

/// Fewer frames and iterations, as far as they are still at their defaults, and some rows of many alike:
/// every kind of experiment runs in minutes, and its figures say nothing.
void make_quick(ReproduceSettings& settings);

/// What `settings.what` asks for. InputError for another word.
Experiments experiments(const ReproduceSettings& settings);

}  // namespace mirage::paper
