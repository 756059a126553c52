#include "validation/fidelity/budget_renderer.h"

#include <algorithm>

#include "validation/fidelity/raster_rungs.h"
#include "validation/fidelity/scene_features.h"

namespace mirage {

BudgetRenderer::BudgetRenderer(std::shared_ptr<ObjectRenderer> dear, StoredBudget budget)
    : dear_(std::move(dear)), budget_(std::move(budget)) {}

ObjectRenderer::Window BudgetRenderer::draw(const HostInWorld& host, const TexturedMesh& adversary,
                                            const Simulated& simulated, std::uint64_t seed) {
  HostScene scene = scene_of(host, adversary);
  scene.simulation.camera_effects = {};  // these come after the light (attack/rendered_pictures.h)
  std::string rung = budget_.choose(budget_.rule.always() ? std::map<std::string, double>{}
                                                          : scene_features(scene, simulated));
  const auto& ours = raster_rungs();
  if (std::find(ours.begin(), ours.end(), rung) == ours.end()) rung = "reference";
  {
    const std::scoped_lock lock(mutex_);
    ++drawn_[rung];
  }
  if (rung == "reference") return dear_->draw(host, adversary, simulated, seed);
  const ImageF& photograph = host.prepared.frame.image;
  const PixelRect rect = full_rect(simulated, photograph);
  return {rect, radiance_of(draw_raster_rung(rung, scene), photograph, rect)};
}

nlohmann::json BudgetRenderer::identity() const {
  nlohmann::json identity = dear_->identity();
  identity["budget"] = {{"budget", budget_.budget}, {"of", to_word(budget_.of)}, {"rule", budget_.hash}};
  return identity;
}

std::map<std::string, int> BudgetRenderer::drawn() const {
  const std::scoped_lock lock(mutex_);
  return drawn_;
}

}  // namespace mirage
