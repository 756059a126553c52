// The verdict's arms and controls with planted detectors: one ignores its picture, one reads only its
// picture.
#include <gtest/gtest.h>

#include <cmath>

#include "fixture.h"
#include "validation/fidelity/ladders.h"
#include "validation/fidelity/summary.h"
#include "validation/fidelity/vehicle_validation.h"

namespace mirage {
namespace {

using nlohmann::json;

OutcomeResult answer(double score, bool hidden, double logit) {
  return {0.9, score, logit, hidden, false};
}

/// A vehicle that the detector finds without the object.
VehicleResult seen_vehicle(const std::string& frame, int label) {
  VehicleResult vehicle;
  vehicle.host = {frame, label};
  vehicle.name = host_name(vehicle.host);
  vehicle.seen.emplace().detected = true;
  return vehicle;
}

/// A vehicle with the object on its roof, and a stand-in for Cycles' picture.
struct Stage {
  PreparedFrame prepared = test::made_up_frame();
  HostScene scene = test::host_scene_of(prepared, test::random_mesh(2), "arms");
  Simulated attacked = simulate(prepared, scene.placement, scene.adversary);
  FullLight full;

  Stage() {
    full.rect = attacked.rect;
    full.image = attacked.image;
    for (int v = full.rect.v0; v < full.rect.v1; ++v)
      for (int u = full.rect.u0; u < full.rect.u1; ++u)
        for (int c = 0; c < 3; ++c) full.image.at(u, v, c) *= 0.5f;
  }
  /// The only camera's.
  const ImageF& shown(const Pictures& pictures) const {
    EXPECT_EQ(pictures.size(), 1u);
    return pictures.at(0) ? *pictures[0] : prepared.frame.image;
  }
  double picture_change(const ImageF& image) const {
    double sum = 0;
    for (std::size_t i = 0; i < image.data.size(); ++i)
      sum += std::abs(image.data[i] - prepared.frame.image.data[i]);
    return sum / attacked.adversary_pixels;
  }
  VehicleResult result(const ViewEvaluator& look, int label) const {
    VehicleResult vehicle = seen_vehicle("00000" + std::to_string(label), label);
    vehicle.seen->raster = vehicle.seen->cycles = answer(0.5, true, 0);
    vehicle.seen->conditions = evaluate_conditions(scene, attacked, attacked, {&full.image}, look);
    return vehicle;
  }
};

/// Hides a vehicle with returns on its roof; the picture hardly changes the score.
OutcomeResult blind_look(const Stage& stage, const ImageF& image, const Sweep& sweep) {
  const bool returns = sweep.size() != stage.prepared.frame.sweep.size();
  return answer(returns ? 0.2 : 0.8, returns, (returns ? -1.4 : 1.4) + 0.01 * stage.picture_change(image));
}

/// Hides a vehicle with changed pixels on its roof.
OutcomeResult seeing_look(const Stage& stage, const ImageF& image, const Sweep&) {
  const double change = stage.picture_change(image);
  return answer(0.5, change > 0.05, 3 - 8 * change);
}

TEST(Arms, SevenArmsAndThreeControlsEachOfItsOwn) {
  const Stage stage;
  ASSERT_GT(stage.attacked.adversary_points, 50);
  std::vector<std::pair<ImageF, Sweep>> views;
  const VerdictResults result =
      evaluate_conditions(stage.scene, stage.attacked, stage.attacked, {&stage.full.image},
                          [&](const Pictures& pictures, const Sweep& sweep) {
                            views.emplace_back(stage.shown(pictures), sweep);
                            return answer(0.5, false, 0);
                          });
  ASSERT_EQ(result.conditions.size(), 7u);
  ASSERT_EQ(result.controls.size(), 3u);
  EXPECT_EQ(result.conditions[0].condition.light, ConditionLight::learned);
  EXPECT_EQ(result.conditions[0].condition.returns, ConditionReturns::learned);
  EXPECT_EQ(result.conditions[1].condition.light, ConditionLight::raster);
  EXPECT_EQ(result.conditions[1].condition.returns, ConditionReturns::ideal);
  EXPECT_EQ(result.conditions[6].condition.light, ConditionLight::cycles);
  EXPECT_EQ(result.conditions[6].condition.returns, ConditionReturns::realistic);
  EXPECT_EQ(views[0].first.data, stage.attacked.image.data);
  views.erase(views.begin());  // a plain run's own arm is raster x ideal
  // The light decides the picture, the returns decide the sweep.
  const ImageF& photograph = stage.prepared.frame.image;
  EXPECT_EQ(views[0].first.data, stage.attacked.image.data);
  EXPECT_EQ(views[0].first.data, views[1].first.data);
  EXPECT_NE(views[0].first.data, views[2].first.data);
  EXPECT_EQ(views[4].first.data, stage.full.image.data);
  EXPECT_EQ(views[0].second.size(), stage.attacked.sweep.size());
  EXPECT_LT(views[1].second.size(), views[0].second.size());  // some drop out
  EXPECT_EQ(views[1].second.size(), views[5].second.size());
  // Controls: noise on the object alone, the photograph, the sweep as recorded.
  EXPECT_GT(stage.picture_change(views[6].first), 0.1);
  for (int v = 0; v < photograph.height; ++v)
    for (int u = 0; u < photograph.width; ++u)
      if (rgba_at(stage.attacked, u, v, 3) == 0) {
        ASSERT_EQ(views[6].first.at(u, v), photograph.at(u, v));
      }
  EXPECT_EQ(views[7].first.data, photograph.data);
  EXPECT_EQ(views[8].first.data, stage.attacked.image.data);
  EXPECT_EQ(views[8].second.size(), stage.prepared.frame.sweep.size());
}

TEST(Arms, TheFirstIsAsTheRunLearnedIt) {
  Stage stage;
  stage.scene.simulation.light = LightModel::visible;
  stage.attacked = simulate_host(stage.scene, stage.scene.simulation);
  SimulationSettings own = stage.scene.simulation;  // of a run with --lidar-effects unit and camera noise
  own.lidar_effects = realistic_returns(stage.scene);
  own.camera_effects.blur_sigma = 0.8;
  const Simulated learned = simulate_host(stage.scene, own);
  std::vector<std::pair<ImageF, Sweep>> views;
  evaluate_conditions(stage.scene, stage.attacked, learned, {&stage.full.image},
                      [&](const Pictures& pictures, const Sweep& sweep) {
                        views.emplace_back(stage.shown(pictures), sweep);
                        return answer(0.5, false, 0);
                      });
  EXPECT_EQ(views[0].first.data, learned.image.data);
  EXPECT_EQ(views[0].second.size(), learned.sweep.size());
  EXPECT_NE(views[0].first.data, stage.attacked.image.data);
  EXPECT_LT(views[0].second.size(), stage.attacked.sweep.size());  // some drop out
  EXPECT_NE(views[1].first.data, stage.attacked.image.data);       // plain light
  EXPECT_EQ(views[3].first.data, stage.attacked.image.data);       // visible
  EXPECT_EQ(views[3].second.size(), stage.attacked.sweep.size());
  EXPECT_EQ(views[9].first.data, learned.image.data);  // no returns
}

Verdict verdict_of(const Stage& stage,
                   const std::function<OutcomeResult(const Stage&, const ImageF&, const Sweep&)>& look) {
  std::vector<VehicleResult> vehicles;
  for (int label = 0; label < 3; ++label)
    vehicles.push_back(
        stage.result([&](const Pictures& pictures,
                         const Sweep& sweep) { return look(stage, stage.shown(pictures), sweep); },
                     label));
  return verdict(vehicles, {"000000"});
}

TEST(Arms, AVerdictOnADetectorThatNeverLooksIsVacuous) {
  const Stage stage;
  const Verdict result = verdict_of(stage, blind_look);
  EXPECT_EQ(result.vacuous(Channel::image), true);
  EXPECT_EQ(result.vacuous(Channel::lidar), false);
  const json written = to_json(result);
  EXPECT_EQ(written.at("vacuous").at("image"), true);
  EXPECT_EQ(written.at("vacuous").at("lidar"), false);
  EXPECT_EQ(written.at("of"), "held_back");
  ASSERT_EQ(written.at("arms").size(), 7u);
  EXPECT_EQ(written.at("arms")[0].at("vehicles"), 1);
  EXPECT_EQ(written.at("arms")[6].at("light"), "cycles");
  EXPECT_EQ(written.at("arms")[6].at("returns"), "realistic");
  EXPECT_EQ(result.all.conditions.at(5).vehicles, 3);
  const auto& condition = result.judged().conditions.at(5);
  EXPECT_EQ(condition.asr.value, 1);
  EXPECT_EQ(condition.difference->value, 0);
  EXPECT_EQ(written.at("arms")[5].at("told"), "cannot be told");  // for one vehicle
  EXPECT_FALSE(written.at("arms")[0].contains("difference"));     // with itself
  EXPECT_EQ(result.nearest_to_reality(true)->key.light, ConditionLight::cycles);
  EXPECT_EQ(result.nearest_to_reality(false)->key.light, ConditionLight::raster);
  const auto& unmet = result.controls.at(2);
  EXPECT_EQ(unmet.key.control, "no returns");
  EXPECT_EQ(written.at("controls").at(2).at("control"), "no returns");
  EXPECT_EQ(unmet.flips, 3);
  EXPECT_EQ(unmet.difference->value, -1);
  EXPECT_NEAR(unmet.mean_delta_logit, 2.8, 1e-9);
  EXPECT_LT(result.controls.at(0).mean_delta_logit, written.at("vacuous").at("bound").get<double>());
}

TEST(Arms, AVerdictOnOneThatLooksIsNot) {
  const Stage stage;
  const Verdict result = verdict_of(stage, seeing_look);
  EXPECT_EQ(result.vacuous(Channel::image), false);
  EXPECT_EQ(result.vacuous(Channel::lidar), true);
  const auto& unseen = result.controls.at(1);
  EXPECT_EQ(unseen.key.control, "photograph");
  EXPECT_EQ(unseen.flips, 3);
  EXPECT_EQ(unseen.asr.value, 0);
}

TEST(Arms, EitherAFlipOrALogitIsEnoughAndNothingIsNothing) {
  const auto verdict_with = [&](const OutcomeResult& control) {
    VehicleResult vehicle = seen_vehicle("a", 0);
    vehicle.seen->raster = vehicle.seen->cycles = answer(0.5, false, 0);
    vehicle.seen->conditions =
        VerdictResults{{{{ConditionLight::raster, ConditionReturns::ideal}, answer(0.5, false, 0)}},
                       {{{Channel::image, "noise"}, control}}};
    return verdict({vehicle}, {});
  };
  EXPECT_EQ(verdict_with(answer(0.5, false, 0.49)).vacuous(Channel::image), true);
  EXPECT_EQ(verdict_with(answer(0.5, false, 0.51)).vacuous(Channel::image), false);
  const Verdict flipped = verdict_with(answer(0.5, true, 0.1));
  EXPECT_EQ(flipped.vacuous(Channel::image), false);
  EXPECT_FALSE(flipped.vacuous(Channel::lidar).has_value());
  EXPECT_TRUE(to_json(flipped).at("vacuous").at("lidar").is_null());
  EXPECT_TRUE(to_json(verdict({}, {})).at("vacuous").at("image").is_null());
}

}  // namespace
}  // namespace mirage
