// Budget and targets of `mirage attack --attack auto`.
#pragma once

#include <cstddef>
#include <vector>

#include "attack/attack_result.h"
#include "attack/attack_settings.h"
#include "attack/attack_step.h"
#include "attack/black_box.h"

namespace mirage {

/// The split of a run's steps. A step is one Adam step on a batch; a forward pass on a vehicle without
/// gradient counts as half of its share of a step.
struct AutoBudget {
  /// A round: every remaining candidate takes `steps` steps, and the better half enters the next round.
  struct Round {
    std::size_t candidates = 0;
    long steps = 0;  ///< of each
  };
  int generations = 0;  ///< of the search
  long search = 0;      ///< cost of the search in steps
  std::vector<Round> rounds;
  /// Total steps of the candidate that reaches the last round.
  long longest() const;
};
/// `generation`: cost of a search generation in steps; 0: no search. FieldError naming iterations if some
/// candidate would get no step in one of its rounds.
AutoBudget auto_budget(long iterations, std::size_t candidates, long generation);

/// The targets of the candidates: the requested one and, for target "both", also each sensor alone if the
/// detector reads both.
std::vector<AttackTarget> auto_targets(AttackTarget requested, const Capabilities& detector);

// `mirage attack --attack auto`: the strongest attack within a budget, in the spirit of AutoAttack (Croce &
// Hein, ICML 2020), for one mesh over many vehicles.
//
//   1. Search. A gradient-free search (attack/black_box.h) warps a cuboid that fills the box, by the
//      objective on a fixed sample of vehicles that are not held out. It takes at most a quarter of the
//      budget.
//   2. Starts. The paper's ellipsoid goes on, and the best of three others by the objective on the held-out
//      vehicles: ellipsoid and cuboid that fill the box, and the searched shape.
//   3. Successive halving (Jamieson & Talwalkar, AISTATS 2016). Starts × targets × rates, each with its own
//      order of the hosts (a restart), learn by Adam. Rounds have equal shares of the remaining steps. The
//      better half of the candidates enters the next round (after the first: of each start's). Rates fall
//      along a half cosine.
//   4. The learned mesh is the one with the lowest held-out objective of any candidate at any check; a start
//      that no step improves stays unchanged.
//
// All meshes are judged in the same worlds (--expect), whatever seed they learned with. Held-out vehicles
// come from whole frames of the training part (attack/attack_hosts.h); the run's test vehicles are never
// used. The objective selects, not the share that vanished: over some 30 vehicles it moves in 3-point steps.
//
//     OUT/checkpoint.json       the run's identity, and how many steps were spent
//     OUT/auto/looks.json       values of the search and of the starts
//     OUT/auto/candidate-N.json checkpoint of a candidate (attack/checkpoint.h)
//
// Each is written atomically, and the files determine what is left to do: a stopped and resumed run, on any
// number of processes, gives the same bits.

/// Shapes in a generation of the search.
inline constexpr int kShapesAGeneration = 24;
/// Frames are held out for selection until they show this many vehicles.
inline constexpr std::size_t kSelectionHosts = 32;

/// Writes run.json (with the held-out vehicles), the files above and the chosen candidate's loss.csv. Returns
/// that candidate's state.
SearchOutcome run_portfolio(const SearchRun& run);

}  // namespace mirage
