// Who draws an attack's object by a validation's rule. The dear renderer is a stand-in; test_cycles_renderer
// has the real one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "fixture.h"
#include "rendered_attack.h"
#include "support/files.h"
#include "validation/fidelity/budget_renderer.h"
#include "validation/fidelity/raster_rungs.h"

namespace mirage {
namespace {

using testing::HasSubstr;

/// Paints the window in one colour, and remembers what it was asked.
class Painter : public ObjectRenderer {
 public:
  Window draw(const HostInWorld& host, const TexturedMesh&, const Simulated& simulated,
              std::uint64_t seed) override {
    const PixelRect rect = full_rect(simulated, host.prepared.frame.image);
    Window window{rect, ImageF(rect.width(), rect.height(), 3)};
    for (float& value : window.picture.data) value = 0.25f;
    seeds.push_back(seed);
    return window;
  }
  nlohmann::json identity() const override { return {{"name", "painter"}}; }
  std::vector<std::uint64_t> seeds;
};

/// What a validation writes of a rule that knows two rungs: error of "hard" 0.9, and of "visible light"
/// `error` at a log_pixels of 7, by a factor of e more for each unit.
nlohmann::json rule_json(double error, double budget = 0.25) {
  const auto& names = scene_feature_names();
  std::vector<double> mean(names.size(), 0), scale(names.size(), 1), hard(names.size() + 1, 0),
      visible = hard;
  hard[0] = std::log(0.9);
  visible[0] = std::log(error);
  for (std::size_t k = 0; k < names.size(); ++k)
    if (names[k] == "log_pixels") mean[k] = 7, visible[k + 1] = 1;
  return {{"budget",
           {{"budget", budget},
            {"of", "radiance"},
            {"confidence", 0.9},
            {"features", names},
            {"lambda", 1.5},
            {"feature_mean", mean},
            {"feature_scale", scale},
            {"rungs",
             {{{"name", "hard"}, {"seconds", 0.01}, {"spread", 0.1}, {"coefficients", hard}},
              {{"name", "visible light"}, {"seconds", 0.02}, {"spread", 0.1}, {"coefficients", visible}},
              {{"name", "+bounces1"}, {"seconds", 0.3}, {"spread", 0.1}, {"coefficients", hard}}}}}}};
}

std::filesystem::path written(const test::TemporaryFolder& folder, const nlohmann::json& result) {
  write_json(folder / "result.json", result);
  return folder.path();
}

TEST(StoredBudget, ChoosesByItsFeaturesAndNothingElse) {
  const test::TemporaryFolder folder;
  const StoredBudget budget = read_budget(written(folder, rule_json(0.2)));
  std::map<std::string, double> scene;
  for (const std::string& name : scene_feature_names()) scene[name] = 0;
  scene["log_pixels"] = 6.9;
  EXPECT_EQ(budget.choose(scene), "visible light");  // 0.18 · e^0.15 = 0.21
  scene["log_pixels"] = 7.2;
  EXPECT_EQ(budget.choose(scene), "reference");  // 0.28
  scene["log_pixels"] = 6.9;
  scene["range"] = 1e3;
  EXPECT_EQ(budget.choose(scene), "visible light");
}

TEST(StoredBudget, IsTheRuleThatWasFitted) {
  RandomStream random(4, "stored budget");
  const std::size_t features = scene_feature_names().size();
  std::vector<BudgetScene> scenes;
  for (int i = 0; i < 60; ++i) {
    BudgetScene scene;
    scene.frame = scene.name = scene.group = std::to_string(i);
    for (std::size_t k = 0; k < features; ++k) scene.features.push_back(3 * random.normal() + 1);
    scene.errors = {0.05 * std::exp(0.3 * scene.features[0]), 0.03 * std::exp(0.2 * random.normal())};
    scene.seconds = scene.alone = {0, 1};
    scene.seconds_full = 10;
    scenes.push_back(scene);
  }
  const BudgetRule fitted(scenes, 0.05, 0.9);
  nlohmann::json result = rule_json(0.2, 0.05);
  result["budget"].update(to_json(fitted));
  for (std::size_t r = 0; r < 2; ++r)
    result["budget"]["rungs"][r]["name"] = r == 0 ? "hard" : "visible light";
  const test::TemporaryFolder folder;
  const StoredBudget stored = read_budget(written(folder, result));
  std::map<int, int> chosen;
  for (const BudgetScene& scene : scenes) {
    EXPECT_EQ(stored.rule.choose(scene.features), fitted.choose(scene.features));
    ++chosen[fitted.choose(scene.features)];
  }
  EXPECT_GT(chosen[0], 5);
  EXPECT_GT(chosen[1], 5);
}

TEST(StoredBudget, WhatIsWrongIsNamed) {
  const test::TemporaryFolder folder;
  const auto said = [&](const char* pointer, const nlohmann::json& value) {
    nlohmann::json result = rule_json(0.2);
    result[nlohmann::json::json_pointer(pointer)] = value;
    return test::error_text<InputError>([&] { read_budget(written(folder, result)); });
  };
  EXPECT_THAT(said("/budget/features", {"range"}),
              HasSubstr("budget.features: are not those of this version"));
  EXPECT_THAT(said("/budget/problem", "too few frames"), HasSubstr("too few frames"));
  EXPECT_THAT(said("/budget/of", "taste"), HasSubstr("budget.of"));
  EXPECT_THAT(said("/budget/feature_scale/0", 0), HasSubstr("budget.feature_scale"));
  EXPECT_THAT(said("/budget/rungs/1/coefficients", {1, 2}), HasSubstr("budget.rungs[1].coefficients"));
  EXPECT_THAT(said("/budget", 3), HasSubstr("budget"));
  EXPECT_THAT(test::error_text<InputError>([&] { read_budget(folder / "nowhere"); }), HasSubstr("nowhere"));
}

TEST(BudgetRenderer, DrawsWhatTheRuleTrustsAndAsksForTheRest) {
  const PreparedFrame prepared = test::made_up_frame();
  const HostId host{"made-up", 0};
  const Placement placement = on_roof(BoxRoofFinder().find(prepared.frame, prepared.frame.labels[0]));
  const SimulationSettings settings;
  const HostInWorld world{prepared, host, placement, settings};
  const TexturedMesh mesh = test::random_mesh(3);
  const HostScene scene = scene_of(world, mesh);
  const Simulated simulated = simulate_host(scene, settings);
  const test::TemporaryFolder folder;
  for (const bool trusted : {true, false}) {
    const auto painter = std::make_shared<Painter>();
    BudgetRenderer renderer(painter, read_budget(written(folder, rule_json(trusted ? 1e-3 : 10))));
    const ObjectRenderer::Window window = renderer.draw(world, mesh, simulated, 9);
    EXPECT_EQ(renderer.identity().at("name"), "painter");
    EXPECT_EQ(renderer.identity().at("budget").at("budget"), 0.25);
    if (trusted) {
      EXPECT_TRUE(painter->seeds.empty());
      EXPECT_EQ(renderer.drawn(), (std::map<std::string, int>{{"visible light", 1}}));
      const ImageF light =
          radiance_of(draw_raster_rung("visible light", scene), prepared.frame.image, window.rect);
      const ImageF plain = radiance_of(draw_raster_rung("hard", scene), prepared.frame.image, window.rect);
      EXPECT_EQ(window.picture.data, light.data);
      EXPECT_NE(window.picture.data, plain.data);
    } else {
      EXPECT_EQ(painter->seeds, std::vector<std::uint64_t>{9});
      EXPECT_EQ(renderer.drawn(), (std::map<std::string, int>{{"reference", 1}}));
      EXPECT_EQ(window.picture.data.front(), 0.25f);
    }
  }
}

TEST(BudgetRenderer, FeaturesHaveTheirNamesAndSeeTheirScene) {
  std::map<std::string, double> near, far, gone;
  for (auto* features : {&near, &far, &gone}) {
    const PreparedFrame prepared =
        features == &gone ? test::made_up_frame(-20) : test::made_up_frame(features == &near ? 9 : 25);
    const HostId host{"made-up", 0};
    const Placement placement = on_roof(BoxRoofFinder().find(prepared.frame, prepared.frame.labels[0]));
    const SimulationSettings settings;
    const HostScene scene = scene_of({prepared, host, placement, settings}, test::random_mesh(3));
    *features = scene_features(scene, simulate_host(scene, settings));
  }
  std::vector<std::string> names;
  for (const auto& [name, value] : near) names.push_back(name);
  EXPECT_EQ(names, scene_feature_names());
  EXPECT_GT(near["log_pixels"], far["log_pixels"] + 1);
  EXPECT_GT(near["light_change"], 0.05);
  EXPECT_GT(near["soft_change"], 0.01);
  EXPECT_EQ(gone["log_pixels"], 0);
  EXPECT_EQ(gone["light_change"], 0);
}

TEST(BudgetRenderer, AnAttackGoesOnToTheSameBits) {
  const test::TemporaryFolder validation;
  // Between the two: some vehicles are near, some far.
  const StoredBudget budget = read_budget(written(validation, rule_json(0.2)));
  test::RenderedAttack attack;
  const auto by_rule = [&](const std::filesystem::path&) {
    return std::make_shared<BudgetRenderer>(std::make_shared<Painter>(), budget);
  };
  EXPECT_EQ(attack.learn("whole", 4, by_rule).at("identity").at("renderer").at("budget").at("rule"),
            budget.hash);
  attack.expect_same_bits_in_parts(by_rule);
}

}  // namespace
}  // namespace mirage
