#include "attack/auto_budget.h"

#include <fmt/format.h>

#include "base/fields.h"

namespace mirage {
namespace {

/// Of the budget, at most: steps by gradient end below warped shapes.
constexpr double kSearchShare = 0.25;

}  // namespace

long AutoBudget::longest() const {
  long steps = 0;
  for (const Round& round : rounds) steps += round.steps;
  return steps;
}

AutoBudget auto_budget(long iterations, std::size_t candidates, long generation) {
  AutoBudget budget;
  for (std::size_t alive = candidates;; alive = (alive + 1) / 2) {
    budget.rounds.push_back({alive, 0});
    if (alive <= 1) break;
  }
  if (generation > 0)
    budget.generations =
        static_cast<int>(kSearchShare * static_cast<double>(iterations) / static_cast<double>(generation));
  const auto left = [&] { return iterations - budget.generations * generation; };
  const auto share = [&] { return left() / static_cast<long>(budget.rounds.size()); };
  while (budget.generations > 0 && share() < static_cast<long>(candidates)) --budget.generations;
  budget.search = budget.generations * generation;
  long used = 0;
  for (AutoBudget::Round& round : budget.rounds) {
    round.steps = share() / static_cast<long>(round.candidates);
    used += round.steps * static_cast<long>(round.candidates);
  }
  if (budget.rounds.front().steps == 0)
    throw FieldError(
        "iterations", std::to_string(iterations),
        fmt::format("--attack auto has {} candidates, and each needs a step in each round", candidates),
        fmt::format("use {} or more", candidates * budget.rounds.size()));
  budget.rounds.back().steps += left() - used;
  return budget;
}

std::vector<AttackTarget> auto_targets(AttackTarget asked, const Capabilities& detector) {
  std::vector<AttackTarget> targets{asked};
  if (asked == AttackTarget::both && detector.reads_points && detector.reads_image)
    targets.insert(targets.end(), {AttackTarget::lidar, AttackTarget::image});
  return targets;
}

}  // namespace mirage
