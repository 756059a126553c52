// `mirage attack --renderer cycles --budget`: each object is drawn as cheaply as a validation's rule allows
// (budget_rule.h), and by the dear renderer where the rule trusts no picture of the rasteriser's.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "attack/object_renderer.h"
#include "validation/fidelity/stored_budget.h"

namespace mirage {

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
