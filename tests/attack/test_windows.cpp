// --objective gap: windows of one vehicle, their loss, and an attack on them.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/windows.h"
#include "base/random.h"
#include "support/files.h"
#include "support/gradient_check.h"
#include "support/tiny_drive.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::HasSubstr;

/// Hosts at ten a second, numbered from `first`; those that `seen` leaves out are none.
std::vector<HostAt> track(
    std::size_t first, int frames, bool (*seen)(int) = [](int) { return true; }) {
  std::vector<HostAt> hosts;
  for (int i = 0; i < frames; ++i)
    if (seen(i)) hosts.push_back({first + hosts.size(), 5 + 0.1 * i});
  return hosts;
}

TEST(Windows, EachIsOfOneVehicleInOrderOfTimeAndOfAllLengths) {
  const std::vector<std::vector<HostAt>> tracks = {
      track(0, 50), track(100, 40, [](int i) { return i % 3 != 1; }), track(200, 6), track(300, 5),
      track(400, 30, [](int i) { return i < 3 || i > 26; })};  // the last two are never followed for so long
  const WindowOrder order(tracks, 8, 3);
  std::map<std::size_t, int> met;
  std::set<int> lengths;  // of the first vehicle's, in tenths
  for (long i = 0; i < 300; ++i) {
    const auto batch = order.batch(i);
    ASSERT_GE(batch.size(), 2u);
    ASSERT_LE(batch.size(), 8u);
    const auto& of = tracks.at(batch.front() / 100);
    std::vector<double> times;
    for (const std::size_t host : batch) {
      ASSERT_EQ(host / 100, batch.front() / 100);
      times.push_back(of.at(host % 100).time);
    }
    EXPECT_TRUE(std::adjacent_find(batch.begin(), batch.end(), std::greater_equal<>()) == batch.end());
    const double length = times.back() - times.front();
    EXPECT_GE(length, kShortestWindow - 1e-9);
    EXPECT_LE(length, kLongestWindow + 1e-9);
    std::vector<std::size_t> between;
    for (std::size_t k = 1; k < batch.size(); ++k) between.push_back(batch[k] - batch[k - 1]);
    const auto [least, most] = std::minmax_element(between.begin(), between.end());
    EXPECT_LE(*most, *least + 1) << "evenly spread";
    EXPECT_TRUE(batch.size() == 8 || *most == 1) << "all there are";
    ++met[batch.front() / 100];
    if (batch.front() < 100) lengths.insert(static_cast<int>(std::lround(10 * length)));
    EXPECT_EQ(WindowOrder(tracks, 8, 3).batch(i), batch) << "any iteration by itself, as a resumed run asks";
  }
  EXPECT_EQ(met, (std::map<std::size_t, int>{{0, 100}, {1, 100}, {2, 100}}));
  EXPECT_GE(lengths.size(), 13u);
  EXPECT_NE(WindowOrder(tracks, 8, 4).batch(7), order.batch(7));
}

void check_weights(const std::vector<double>& hide) {
  test::check_gradient([](const std::vector<double>& h) { return window_loss(h).value; }, hide,
                       window_loss(hide).weights, 1e-5, 1e-6);
}

TEST(Windows, WeightsAreTheDerivativeOfTheLoss) {
  RandomStream random(4, "hide");
  for (int i = 0; i < 200; ++i) {
    std::vector<double> hide(static_cast<std::size_t>(1 + random.below(10)));
    for (double& h : hide) h = random.uniform() < 0.3 ? 0 : std::exp(random.uniform(-6, 3));
    check_weights(hide);
  }
  check_weights({0.7});
  check_weights({0, 0, 0, 0});
  check_weights({1e-9, 1e-9});
  check_weights({1e-9, 40, 1e-9, 40, 40});
}

TEST(Windows, TheLongestRunCounts) {
  EXPECT_EQ(window_loss({{3.5}}).value, 3.5);
  EXPECT_EQ(window_loss({{0, 0, 0}}).value, 0);
  // Found everywhere, it is nearly the mean; hidden in the middle, half of that.
  EXPECT_NEAR(window_loss(std::vector<double>(9, 20.0)).value, 20 - std::log(9) / 9, 1e-6);
  std::vector<double> cut(9, 20.0);
  cut[4] = 0;
  EXPECT_NEAR(window_loss(cut).value, (80 - std::log(4.5)) / 9, 1e-6);
  // What bridges two runs weighs as much as they do.
  const WindowLoss bridge = window_loss(cut);
  EXPECT_GT(bridge.weights[4], 10 * bridge.weights[7]);
  const WindowLoss huge = window_loss({{1e6, 1e6, 0, 1e6}});
  EXPECT_NEAR(huge.value, 0.5e6, 1);
  for (const double w : huge.weights) EXPECT_TRUE(std::isfinite(w)) << w;
}

AttackSettings gap_settings(const TemporaryFolder& folder, const char* out, int iterations) {
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "drive";
  settings.out = folder / out;
  settings.objective_of = ObjectiveOf::gap;
  settings.batch = 4;
  settings.iterations = iterations;
  settings.checkpoint.steps = 1;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

TEST(Windows, AnAttackLearnsAndGoesOnToTheSameBits) {
  const TemporaryFolder folder;
  test::write_tiny_drive(folder / "drive", folder / "object", 10);
  const DetectorPool one = test::one_of<test::StandInDetector>();
  DetectorPool three = test::one_of<test::StandInDetector>();
  for (int i = 0; i < 2; ++i) three.push_back(std::make_unique<test::StandInDetector>());
  run_attack(gap_settings(folder, "whole", 12), one);
  run_attack(gap_settings(folder, "parts", 5), three);
  run_attack(gap_settings(folder, "parts", 12), one);
  for (const char* file : {"adversary.glb", "loss.csv"})
    EXPECT_EQ(read_file(folder / "whole" / file), read_file(folder / "parts" / file)) << file;
  const mirage::Run run = read_run(folder / "whole");
  EXPECT_EQ(run.settings.objective_of, ObjectiveOf::gap);
  AttackSettings other = gap_settings(folder, "whole", 13);
  other.objective_of = ObjectiveOf::frame;
  EXPECT_THAT(error_text<InputError>([&] { run_attack(other, one); }), HasSubstr("objective"));
}

TEST(Windows, AStepFollowsTheGradientOfTheWindowsLoss) {
  const TemporaryFolder folder;
  test::write_tiny_drive(folder / "drive", folder / "object", 10);
  AttackSettings settings = gap_settings(folder, "run", 1);
  settings.objective.lambda_fp = 0;
  const DetectorPool detectors = test::one_of<test::StandInDetector>();
  FrameStore store(settings);
  const auto hosts = find_all_hosts(store, list_frames(settings.data), detectors.front()->region(),
                                    settings.simulation, settings.min_view);
  AttackState state = fresh_state(settings);
  TexturedMesh mesh = state.adversary;
  const AttackStepper stepper(settings, detectors, store, hosts, mesh.mesh);
  const LossRow row = stepper.step(state);
  const auto batch = WindowOrder(followed(settings.data, hosts), settings.batch, settings.seed).batch(0);
  const auto loss = [&](const std::vector<double>& texels) {
    for (std::size_t i = 0; i < texels.size(); ++i)
      mesh.atlas.texels[i / 3][static_cast<Eigen::Index>(i % 3)] = texels[i];
    std::vector<double> hide;
    for (const std::size_t k : batch) {
      const auto prepared = store.get(hosts[k].id.frame);
      hide.push_back(judge_host(*detectors.front(), {*prepared, hosts[k].id, store.placement(hosts[k].id)},
                                mesh, settings)
                         .hide);
    }
    return window_loss(hide).value;
  };
  const auto texels = test::flat(mesh.atlas.texels);
  EXPECT_NEAR(row.hide, loss(texels), 1e-12);
  std::vector<double> gradient = state.texels.first;  // Adam's first moment after one step
  for (double& d : gradient) d /= 1 - state.texels.beta1;
  double most = 0;
  for (const double d : gradient) most = std::max(most, std::abs(d));
  ASSERT_GT(most, 0);
  const auto checked = test::check_gradient(loss, texels, gradient, 0.2, 0.02, most / 10, [&](std::size_t i) {
    return i % 97 == 0 && std::abs(gradient[i]) > most / 10;
  });
  EXPECT_GT(checked.checked, 5);
}

TEST(Windows, WhatCannotBeWindowedIsRefused) {
  const TemporaryFolder folder;
  test::write_tiny_drive(folder / "drive", folder / "object", 4);
  const DetectorPool detectors = test::one_of<test::StandInDetector>();
  const auto refused = [&](auto&& change) {
    AttackSettings settings = gap_settings(folder, "run", 1);
    change(settings);
    return error_text<FieldError>([&] { run_attack(settings, detectors); });
  };
  EXPECT_THAT(refused([](AttackSettings&) {}),
              HasSubstr("drive is followed through 0.5 s; give longer drives"));
  EXPECT_THAT(refused([&](AttackSettings& s) { s.data = folder / "object"; }),
              testing::StartsWith("objective: gap: no training vehicle of "));
  EXPECT_THAT(refused([&](AttackSettings& s) { s.data = folder / "object"; }), HasSubstr("of no sequence"));
  EXPECT_THAT(refused([](AttackSettings& s) { s.batch = 1; }), HasSubstr("batch: 1: --objective gap"));
  EXPECT_THAT(refused([](AttackSettings& s) { s.attack = AttackSearch::automatic; }),
              HasSubstr("objective: gap: does not go with --attack auto"));
  EXPECT_THAT(refused([](AttackSettings& s) { s.attack = AttackSearch::black_box; }),
              HasSubstr("objective: gap: does not go with --attack black-box"));
}

}  // namespace
}  // namespace mirage
