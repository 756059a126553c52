#include "validation/fidelity/budget_renderer.h"

#include <fmt/format.h>

#include <algorithm>

#include "base/error.h"
#include "base/files.h"
#include "validation/fidelity/raster_rungs.h"

namespace mirage {
namespace {

constexpr const char* kFix =
    "give the folder of `mirage validate --ladder N --budget SHARE`, with frames enough for a rule";

std::vector<std::string> words(const JsonFields& fields, const std::string& key, const nlohmann::json& list) {
  std::vector<std::string> out;
  for (const auto& word : list) {
    if (!word.is_string()) fields.fail(key, "has an entry that is no text");
    out.push_back(word.get<std::string>());
  }
  return out;
}

}  // namespace

std::string StoredBudget::choose(const std::map<std::string, double>& of_scene) const {
  std::vector<double> values;
  for (const std::string& name : features)
    if (!rule.always()) values.push_back(of_scene.at(name));
  const int rung = rule.choose(values);
  return rung < 0 ? "reference" : rungs[static_cast<std::size_t>(rung)];
}

StoredBudget read_budget(const std::filesystem::path& validation) {
  const std::filesystem::path file =
      std::filesystem::is_directory(validation) ? validation / "result.json" : validation;
  const nlohmann::json json = read_json(file);
  const JsonFields written = JsonFields(file, json, kFix).object("budget");
  if (written.has("problem"))
    written.fail("problem", "says that there is no rule: " + written.text("problem"));
  const double budget = written.number("budget", 1e-9, 1e3);
  const std::string of = written.text("of");
  if (of != to_word(BudgetOf::radiance) && of != to_word(BudgetOf::score))
    written.fail("of", fmt::format("is \"{}\", not radiance or score", of));
  const std::vector<std::string> features = words(written, "features", written.list("features", kMostRungs));
  if (features != scene_feature_names()) written.fail("features", "are not those of this version");
  const nlohmann::json& list = written.list("rungs", kMostRungs);
  std::vector<std::string> rungs;
  for (std::size_t r = 0; r < list.size(); ++r)
    rungs.push_back(written.inner(fmt::format("rungs[{}]", r), list[r]).text("name"));
  return {BudgetRule(written, budget, features.size(), rungs.size()),
          budget,
          of == to_word(BudgetOf::score) ? BudgetOf::score : BudgetOf::radiance,
          features,
          rungs,
          content_hash(json.at("budget").dump())};
}

BudgetRenderer::BudgetRenderer(std::shared_ptr<ObjectRenderer> dear, StoredBudget budget)
    : dear_(std::move(dear)), budget_(std::move(budget)) {}

ObjectRenderer::Window BudgetRenderer::draw(const HostInWorld& host, const TexturedMesh& adversary,
                                            const Simulated& simulated, std::uint64_t seed) {
  HostScene scene = scene_of(host, adversary);
  scene.simulation.camera_effects = {};  // these come after the light (attack/object_renderer.h)
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
