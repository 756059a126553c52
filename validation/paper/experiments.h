// The experiments of Tu et al., "Exploring Adversarial Robustness of Multi-sensor Perception Systems in Self
// Driving" (CoRL 2021, arXiv 2101.06784), as a list: which commands of mirage each table needs, and what the
// paper printed in its cells.
//
//     table1   attack success, KITTI rig: LiDAR-only detector through LiDAR; fusion under a random mesh, and
//              attacked through LiDAR, through the image and through both
//     table2   the same with the rig of the paper's larger set (xenith)
//     fig3     recall over IoU for the same attacks
//     fig4     attack success against the box half size L, 0.2 m to 1.0 m
//     table3   transfer between rigs and between detectors, black box
//     table4   defences, each attacked anew (white box), with clean AP
//     real     table1 and transfer onto it, on frames of the user (--real), with table1 and all
//     parts    not in the paper: shape, texture or size of the object alone (object_parts.h)
//     fusions  not in the paper: six detectors, each attacked through each of its sensors, and every mesh
//              judged by all six (fusions.h); fusions-xenith: the same with the other rig
//
// The order is that of the experiments in the paper; which number its own tables carry is not known to us.
// Numbers of the paper are facts that are quoted where they are certain, in per cent as printed; a cell
// without one stays empty.
#pragma once

#include <filesystem>
#include <string>

#include "validation/paper/cases.h"

namespace mirage::paper {

/// Whether what a defence (a word of --defense, or several) does is about the picture. It is not: adversarial
/// training, its control on roofs and the sweep's bodies.
bool concerns_picture(const std::string& defense);

/// Fewer frames and iterations, as far as they are still at their defaults, and some rows of many alike:
/// every kind of experiment runs in minutes, and its figures say nothing.
void make_quick(ReproduceSettings& settings);

/// What `settings.what` asks for. InputError for another word.
Experiments experiments(const ReproduceSettings& settings);

}  // namespace mirage::paper
