// The rule that a validation fitted (budget.h), for scenes of others.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "validation/fidelity/budget.h"

namespace mirage {

struct StoredBudget {
  BudgetRule rule;
  double budget = 0;
  BudgetOf of = BudgetOf::radiance;
  std::vector<std::string> features, rungs;  ///< in the rule's order
  std::string hash;                          ///< of everything above

  /// The rung for a scene of these features (scene_features.h); "reference" where the rule trusts none. The
  /// features are all there, but for a rule of one rung for all, which asks none.
  std::string choose(const std::map<std::string, double>& of_scene) const;
};

/// From `budget` of a validation's result.json, or of the folder that holds it. InputError naming file and
/// field; also where the validation had too few scenes for a rule, or its features are not today's.
StoredBudget read_budget(const std::filesystem::path& validation);

}  // namespace mirage
