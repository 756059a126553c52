// `mirage attack --attack black-box`: a mesh learned from a detector's scores alone.
//
//   1. Starts. The paper's ellipsoid, and an ellipsoid and a cuboid filling the box, are judged on a fixed
//      sample of the training vehicles; the best goes on.
//   2. Search. Its size, warp and colours by few numbers (attack/mesh_modes.h), by an evolution strategy
//      (attack/evolution.h). The meshes of a generation are judged on the same `batch` vehicles of the
//      sample, those of the next on others (attack/attack_hosts.h). The objective is that of the gradient
//      attack.
//   3. Where the strategy has arrived is judged on the whole sample, and is kept if it is better than the
//      start.
//
// A query is a pass of the detector over a frame with the object. The number asked for is never exceeded;
// what is less than a generation is left.
//
//     OUT/checkpoint.json  identity, and losses of each mesh looked at; the strategy is restored by them
//     OUT/loss.csv         a row a mesh
#pragma once

#include "attack/attack_result.h"
#include "attack/search.h"

namespace mirage {

/// How queries are spent.
struct BlackBoxPlan {
  int samples = 0;  ///< meshes a generation
  long generations = 0;
};
/// For `starts` starts, `numbers` numbers that make a mesh, and a sample of `vehicles`. FieldError naming
/// queries if they are too few for a generation.
BlackBoxPlan black_box_plan(const AttackSettings& settings, std::size_t starts, std::size_t numbers,
                            std::size_t vehicles);

/// What came of it.
struct BlackBoxOutcome {
  AttackState state;  ///< its mesh the learned one, its losses those of all meshes looked at
  BlackBoxReport report;
  StageSeconds stages;  ///< of this process
  long first = 0;       ///< meshes looked at before this process
};
/// Writes run.json and the files above. The same bits however often it was stopped, on any number of
/// processes.
BlackBoxOutcome run_black_box(const SearchRun& run);

}  // namespace mirage
