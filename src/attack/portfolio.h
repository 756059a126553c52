// How the steps of `mirage attack --attack auto` are spent, and on which targets (attack/portfolio.h).
#pragma once

#include <cstddef>
#include <vector>

#include "attack/attack_result.h"
#include "attack/attack_settings.h"
#include "attack/attack_step.h"
#include "attack/black_box.h"

namespace mirage {

/// How the steps of a run are spent. A step is one of Adam on a batch; a look at a vehicle, which needs no
/// way back, is counted as half of a vehicle's step.
struct AutoBudget {
  /// A round: every candidate left takes its steps, and the better half enters the next.
  struct Round {
    std::size_t candidates = 0;
    long steps = 0;  ///< of each
  };
  int generations = 0;  ///< of the search
  long search = 0;      ///< steps that these cost
  std::vector<Round> rounds;
  /// Steps of the candidate that is left in the last round.
  long longest() const;
};
/// `generation`: steps that one costs; 0: there is no search. FieldError naming iterations if not every
/// candidate gets a step in each of its rounds.
AutoBudget auto_budget(long iterations, std::size_t candidates, long generation);

/// Whose gradients the candidates follow: the target that was asked for and, with both, each sensor that the
/// detector reads, alone.
std::vector<AttackTarget> auto_targets(AttackTarget requested, const Capabilities& detector);

// `mirage attack --attack auto`: what an attack can do at best within a budget, in the spirit of AutoAttack
// (Croce & Hein, ICML 2020), for one mesh over many vehicles.
//
//   1. Search. A cuboid that fills the box is warped without gradients (attack/black_box.h), for at most a
//      quarter of the budget, by the objective on a fixed sample of the vehicles that are learned on.
//   2. Starts. The paper's ellipsoid, ellipsoid and cuboid filling the box, and what was found, as they are:
//      the paper's goes on, and of the others the best by the objective on the held-out vehicles.
//   3. Successive halving (Jamieson & Talwalkar, AISTATS 2016). Starts × targets × rates, each with its own
//      order of the hosts (a restart), learn by Adam; each round has an equal share of the steps that are
//      left, and the better half of the candidates comes into the next (of the first round, of each start's).
//      Rates fall along a half cosine.
//   4. The mesh of the lowest held-out objective that any candidate had at any look is what was learned; a
//      start that no step improves is kept as it is.
//
// Every mesh that is chosen among is judged in the same worlds (--expect), whatever seed it learned by.
// Held out are whole frames of the training part (attack/attack_hosts.h); the run's test vehicles are
// never looked at. The objective chooses, not the share that vanished: over some 30 vehicles that share moves
// in steps of 3 points.
//
//     OUT/checkpoint.json       the run's identity, and how many steps were spent
//     OUT/auto/looks.json       values of the search and of the starts
//     OUT/auto/candidate-N.json checkpoint of a candidate (attack/checkpoint.h)
//
// Each is written atomically, and the order of work follows from them: a stopped run, on any number of
// processes, ends with the same bits.

/// Shapes a generation of the search.
inline constexpr int kShapesAGeneration = 24;
/// At most so many vehicles are held out to choose by.
inline constexpr std::size_t kSelectionHosts = 32;

/// Writes run.json (with the vehicles held out), the files above and the chosen candidate's loss.csv; has
/// that candidate's state.
SearchOutcome run_portfolio(const SearchRun& run);

}  // namespace mirage
