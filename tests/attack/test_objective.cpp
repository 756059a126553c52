#include <gtest/gtest.h>

#include "attack/evaluation.h"
#include "attack/objective.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

const BevBox kHost{10, 0, 4, 2, 0};

TEST(Objective, SoftplusIsStable) {
  EXPECT_NEAR(softplus(0), std::log(2), 1e-15);
  EXPECT_NEAR(softplus(800), 800, 1e-12);
  EXPECT_EQ(softplus(-800), 0);
}

TEST(Objective, WeighsRelevantByOverlapAndRewardsFalsePositives) {
  const std::vector<Proposal> proposals{{kHost, 2.0},                // on the host
                                        {{12, 0, 4, 2, 0}, 1.0},     // IoU 1/3 with it
                                        {{10, 0, 4, 2, 0}, -4.0},    // score below 0.1
                                        {{30, 0, 4, 2, 0}, 0.5},     // overlaps another car
                                        {{50, 10, 4, 2, 0}, -1.0}};  // overlaps nothing
  const std::vector<BevBox> truth{kHost, {31, 0, 4, 2, 0}};
  ObjectiveSettings settings;
  settings.lambda_fp = 0.5;
  const ObjectiveValue value = objective(proposals, kHost, truth, settings);
  EXPECT_NEAR(value.hide, softplus(2) + softplus(1) / 3, 1e-12);
  EXPECT_NEAR(value.false_positive, -0.5 * softplus(-1), 1e-12);
  EXPECT_EQ(value.d_logits[2], 0);
  EXPECT_EQ(value.d_logits[3], 0);
  EXPECT_GT(value.d_logits[0], 0);
  EXPECT_LT(value.d_logits[4], 0);
}

TEST(Objective, GradientInLogits) {
  std::vector<Proposal> proposals{
      {kHost, 2.0}, {{11, .5, 4, 2, .3}, 40}, {{50, 10, 4, 2, 0}, -1.0}, {{60, 0, 4, 2, 0}, 35}};
  const std::vector<BevBox> truth{kHost};
  const auto f = [&](const std::vector<double>& logits) {
    for (std::size_t i = 0; i < logits.size(); ++i) proposals[i].logit = logits[i];
    const auto value = objective(proposals, kHost, truth, {});
    return value.hide + value.false_positive;
  };
  const auto gradient = objective(proposals, kHost, truth, {}).d_logits;
  test::check_gradient(f, {2.0, 40, -1.0, 35}, gradient, 1e-5, 1e-8);
}

Frame frame_with_host() {
  Frame frame;
  Label host;
  host.type = "Car";
  host.box.bev = kHost;
  frame.labels = {host};
  return frame;
}

TEST(Evaluation, JudgesMissesAndFalsePositives) {
  const Frame frame = frame_with_host();
  const Proposal on{kHost, 3}, off{{12, 0, 4, 2, 0}, 3}, elsewhere{{40, 5, 4, 2, 0}, 3};
  const EvaluationSettings settings;
  EXPECT_FALSE(judge({"0", 0}, frame, {on}, {on}, settings).hidden);
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {}, settings).hidden);
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {off}, settings).hidden);           // IoU 1/3 is a miss at 0.7
  EXPECT_FALSE(judge({"0", 0}, frame, {on}, {off}, settings).false_positive);  // … but no new object
  EXPECT_FALSE(judge({"0", 0}, frame, {}, {}, settings).hidden);  // was not detected in the first place
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {on, elsewhere}, settings).false_positive);
  EXPECT_FALSE(
      judge({"0", 0}, frame, {on, elsewhere}, {on, elsewhere}, settings).false_positive);  // known before
  EXPECT_NEAR(judge({"0", 0}, frame, {on}, {on, elsewhere}, settings).false_positive_distance,
              std::hypot(30, 5), 1e-9);
}

TEST(Evaluation, SharesAreOfTheVehiclesDetectedClean) {
  const Frame frame = frame_with_host();
  const Proposal on{kHost, 3}, elsewhere{{40, 5, 4, 2, 0}, 3};
  const EvaluationSettings settings;
  const Evaluation result = summarize(
      {judge({"0", 0}, frame, {on}, {}, settings), judge({"1", 0}, frame, {on}, {on, elsewhere}, settings),
       judge({"2", 0}, frame, {on}, {on}, settings), judge({"3", 0}, frame, {on}, {elsewhere}, settings),
       judge({"4", 0}, frame, {}, {elsewhere}, settings)});
  EXPECT_EQ(result.vehicles, 4);
  EXPECT_NEAR(result.fn_asr, 0.5, 1e-12);
  EXPECT_NEAR(result.fp_asr, 0.5, 1e-12);
  EXPECT_NEAR(result.asr, 0.75, 1e-12);
  EXPECT_NEAR(result.recall_clean.front().value, 0.8, 1e-12);
  EXPECT_NEAR(result.recall_attacked.back().value, 0.4, 1e-12);
}

}  // namespace
}  // namespace mirage
