// The rule that a validation fitted (budget.h), for scenes of others.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "attack/object_renderer.h"
#include "validation/fidelity/budget.h"

namespace mirage {

struct StoredBudget {
  BudgetRule rule;
  double budget = 0;
  BudgetOf of = BudgetOf::radiance;
  std::vector<std::string> features, rungs;  ///< in the rule's order
  std::string hash;                          ///< of everything above

  /// The rung for a scene of these features (raster_rungs.h); "reference" where the rule trusts none. The
  /// features are all there, but for a rule of one rung for all, which asks none.
  std::string choose(const std::map<std::string, double>& of_scene) const;
};

/// From `budget` of a validation's result.json, or of the folder that holds it. InputError naming file and
/// field; also where the validation had too few scenes for a rule, or its features are not today's.
StoredBudget read_budget(const std::filesystem::path& validation);

// `mirage attack --renderer cycles --budget`: each object is drawn as cheaply as a validation's rule allows
// (budget.h), and by the dear renderer where the rule trusts no picture of the rasteriser's.

class BudgetRenderer : public ObjectRenderer {
 public:
  BudgetRenderer(std::shared_ptr<ObjectRenderer> dear, StoredBudget budget);
  /// The rule's rung if the rasteriser draws it (raster_rungs.h), else the dear renderer's picture: a rung of
  /// Cycles with fewer effects has no cheaper worker here.
  Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
              std::uint64_t seed) override;
  /// The dear one's, and `budget`: {budget, of, rule: a hash}.
  nlohmann::json identity() const override;
  /// Pictures so far, by the rung that was drawn; "reference": by the dear renderer.
  std::map<std::string, int> drawn() const;

 private:
  std::shared_ptr<ObjectRenderer> dear_;
  StoredBudget budget_;
  mutable std::mutex mutex_;
  std::map<std::string, int> drawn_;
};

}  // namespace mirage
