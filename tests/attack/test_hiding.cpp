// What counts as hidden, on outcomes whose shares are known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "attack/evaluation.h"

namespace mirage {
namespace {

const BevBox kParked{10, 0, 4, 2, 0};

HostOutcome judged_host(const std::string& frame_name, const std::vector<Detection>& clean,
                        const std::vector<Detection>& attacked) {
  Frame frame;
  Label label;
  label.type = "Car";
  label.box.bev = kParked;
  frame.labels = {label};
  return judge({frame_name, 0}, frame, clean, attacked, EvaluationSettings());
}

TEST(Hiding, ABoxThatOnlyTurnedIsHiddenForTheSeedAndHasNotVanished) {
  const Detection on{kParked, 3};
  // Turned on the spot by 0.4 rad: IoU 0.68, its centre where it was.
  const Detection turned{{10, 0, 4, 2, 0.4}, 3};
  const HostOutcome outcome = judged_host("0", {on}, {turned});
  EXPECT_GT(outcome.attacked_iou, 0.5);
  EXPECT_LT(outcome.attacked_iou, 0.7);
  EXPECT_TRUE(outcome.hidden);
  EXPECT_EQ(outcome.attacked_distance, 0);
  const HidingRates rates = hiding_rates(std::vector{outcome});
  EXPECT_EQ(rates.iou70.share.value, 1);
  EXPECT_EQ(rates.iou50.share.value, 0);
  EXPECT_EQ(rates.vanished.share.value, 0);
  EXPECT_EQ(rates.distance1m->share.value, 0);
}

TEST(Hiding, EachRuleHasItsOwnDenominator) {
  const Detection on{kParked, 3};
  const Detection shifted{{11.5, 0, 4, 2, 0}, 3};  // IoU 5/11, 1.5 m
  const Detection corner{{13.2, 0, 4, 2, 0}, 3};   // IoU 1/9, 3.2 m
  const Detection elsewhere{{40, 5, 4, 2, 0}, 3};  // IoU 0
  const std::vector<HostOutcome> hosts = {
      judged_host("0", {on}, {on}),          // found by every rule
      judged_host("1", {on}, {shifted}),     // hidden at 0.7, 0.5 and 1 m
      judged_host("2", {on}, {corner}),      // … and at 2 m, but something stands there
      judged_host("3", {on}, {elsewhere}),   // vanished
      judged_host("4", {on}, {}),            // vanished
      judged_host("5", {shifted}, {}),       // counts for 0.1 and 2 m alone: vanished
      judged_host("6", {corner}, {corner}),  // counts for 0.1 alone: there
      judged_host("7", {elsewhere}, {}),     // counts nowhere
      judged_host("8", {}, {on})};
  const HidingRates rates = hiding_rates(hosts);
  EXPECT_EQ(rates.iou70.vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.iou70.share.value, 4 / 5.);
  EXPECT_EQ(rates.iou50.vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.iou50.share.value, 4 / 5.);
  EXPECT_EQ(rates.vanished.vehicles, 7);
  EXPECT_DOUBLE_EQ(rates.vanished.share.value, 3 / 7.);
  EXPECT_EQ(rates.distance1m->vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.distance1m->share.value, 4 / 5.);
  EXPECT_EQ(rates.distance2m->vehicles, 6);
  EXPECT_DOUBLE_EQ(rates.distance2m->share.value, 4 / 6.);
  EXPECT_LT(rates.vanished.share.low, 3 / 7.);
  EXPECT_GT(rates.vanished.share.high, 3 / 7.);

  const Evaluation all = summarize(hosts);
  EXPECT_EQ(all.vehicles, 5);
  EXPECT_DOUBLE_EQ(all.fn_asr, rates.iou70.share.value);  // the seed's rule is one of them
  const nlohmann::json json = to_json(all);
  EXPECT_EQ(json.at("hidden").at("vanished").at("vehicles"), 7);
  EXPECT_DOUBLE_EQ(json.at("hidden").at("distance2m").at("value"), 4 / 6.);
  EXPECT_TRUE(json.at("asr").is_number());  // the key of before keeps its meaning
  EXPECT_DOUBLE_EQ(json.at("outcomes").at(1).at("attacked_distance"), 1.5);
  EXPECT_TRUE(json.at("outcomes").at(4).at("attacked_distance").is_null());  // no detection at all
}

TEST(Hiding, NothingFoundCleanTellsNothing) {
  const HidingRates rates = hiding_rates(std::vector{judged_host("0", {}, {})});
  EXPECT_EQ(rates.vanished.vehicles, 0);
  EXPECT_EQ(rates.vanished.share.low, 0);
  EXPECT_EQ(rates.vanished.share.high, 1);
  EXPECT_EQ(hiding_rates({}).iou70.vehicles, 0);
}

TEST(Hiding, InThePictureThereAreNoMetres) {
  Frame frame;
  Label label;
  label.type = "Car";
  label.box.bev = kParked;
  label.left = 100, label.top = 100, label.right = 200, label.bottom = 150;
  frame.labels = {label};
  EvaluationSettings settings;
  settings.matching = kInPicture;
  const Detection on{{}, 3, {100, 100, 200, 150}}, half{{}, 3, {100, 100, 160, 150}};
  const auto outcome = judge({"0", 0}, frame, {on}, {half}, settings);
  EXPECT_TRUE(std::isinf(outcome.clean_distance));
  const Evaluation made = summarize({outcome});
  EXPECT_FALSE(made.hiding.distance1m || made.hiding.distance2m);
  EXPECT_EQ(made.hiding.iou70.share.value, 1);  // IoU 0.6
  EXPECT_EQ(made.hiding.iou50.share.value, 0);
  const auto json = to_json(made);
  EXPECT_TRUE(json.at("hidden").at("distance1m").is_null());
  EXPECT_FALSE(json.at("outcomes").at(0).contains("clean_distance"));
  const auto net = to_json(net_success(made.hosts, made.hosts));
  EXPECT_TRUE(net.at("distance2m").is_null());
  EXPECT_EQ(net.at("iou70").at("value"), 0);
}

TEST(Hiding, NetIsPairedOverTheSameHosts) {
  // The same half of the frames is hard for both meshes; the learned one hides one vehicle more in each.
  const Detection on{kParked, 3}, ghost{{40, 5, 4, 2, 0}, 3};
  std::vector<HostOutcome> learned, control;
  for (int frame = 0; frame < 40; ++frame)
    for (int host = 0; host < 5; ++host) {
      const bool hard = frame % 2 == 0;
      const auto with = [&](bool hidden) {
        HostOutcome made =
            judged_host(std::to_string(frame), {on}, hidden ? std::vector{ghost} : std::vector{on});
        made.id.label = host;
        return made;
      };
      learned.push_back(with(host < (hard ? 4 : 1)));
      control.push_back(with(host < (hard ? 3 : 0)));
    }
  const NetSuccess net = net_success(learned, control);
  EXPECT_NEAR(net.vanished.value, 0.2, 1e-12);
  // In every frame alike: the pairing leaves no spread but one flip more than was seen …
  EXPECT_NEAR(net.vanished.low, 0.2, 0.015);
  const Interval alone = hiding_rates(learned).vanished.share;
  EXPECT_GT(alone.high - alone.low, 0.15);  // … where either share by itself is uncertain
  EXPECT_NEAR(net.false_positive.value, 0.2, 1e-12);
  EXPECT_NEAR(net.asr.value, 0.2, 1e-12);
  EXPECT_NEAR(net.distance2m->value, 0.2, 1e-12);
  // Twice the control, as two meshes: its share is the same, and so is the difference.
  std::vector<HostOutcome> twice = control;
  for (HostOutcome host : control) host.mesh = 1, twice.push_back(host);
  EXPECT_NEAR(net_success(learned, twice).vanished.value, 0.2, 1e-12);
  EXPECT_EQ(hiding_rates(twice).vanished.vehicles, 200);
}

}  // namespace
}  // namespace mirage
