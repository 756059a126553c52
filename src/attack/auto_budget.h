// How the steps of `mirage attack --attack auto` are spent, and on which targets (attack/portfolio.h).
#pragma once

#include <cstddef>
#include <vector>

#include "attack/attack_settings.h"

namespace mirage {

/// How the steps of a run are spent. A step is one of Adam on a batch; a look at a vehicle, which needs no
/// way back, is counted as half of a vehicle's step.
struct AutoBudget {
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
std::vector<AttackTarget> auto_targets(AttackTarget asked, const Capabilities& detector);

}  // namespace mirage
