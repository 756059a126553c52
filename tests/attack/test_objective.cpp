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
  const std::vector<Detection> proposals{{kHost, 2.0},                // on the host
                                         {{12, 0, 4, 2, 0}, 1.0},     // IoU 1/3 with it
                                         {{10, 0, 4, 2, 0}, -4.0},    // score below 0.1
                                         {{30, 0, 4, 2, 0}, 0.5},     // overlaps another car
                                         {{50, 10, 4, 2, 0}, -1.0}};  // overlaps nothing
  const std::vector<ObjectBoxes> truth{kHost, BevBox{31, 0, 4, 2, 0}};
  ObjectiveSettings settings;
  settings.lambda_fp = 0.5;
  const ObjectiveValue value = objective(proposals, {kHost, truth}, settings);
  EXPECT_NEAR(value.hide, softplus(2) + softplus(1) / 3, 1e-12);
  EXPECT_NEAR(value.false_positive, -0.5 * softplus(-1), 1e-12);
  EXPECT_EQ(value.d_logits[2], 0);
  EXPECT_EQ(value.d_logits[3], 0);
  EXPECT_GT(value.d_logits[0], 0);
  EXPECT_LT(value.d_logits[4], 0);
}

TEST(Objective, GradientInLogits) {
  std::vector<Detection> proposals{
      {kHost, 2.0}, {{11, .5, 4, 2, .3}, 40}, {{50, 10, 4, 2, 0}, -1.0}, {{60, 0, 4, 2, 0}, 35}};
  const std::vector<ObjectBoxes> truth{kHost};
  const auto f = [&](const std::vector<double>& logits) {
    for (std::size_t i = 0; i < logits.size(); ++i) proposals[i].logit = logits[i];
    const auto value = objective(proposals, {kHost, truth}, {});
    return value.hide + value.false_positive;
  };
  const auto gradient = objective(proposals, {kHost, truth}, {}).d_logits;
  test::check_gradient(f, {2.0, 40, -1.0, 35}, gradient, 1e-5, 1e-8);
}

Frame frame_with_cars() {
  Frame frame;
  Label host;
  host.type = "Car";
  host.box.bev = kHost;
  frame.labels = {host};
  return frame;
}

TEST(Evaluation, JudgesMissesAndFalsePositives) {
  const Frame frame = frame_with_cars();
  const Detection on{kHost, 3}, off{{12, 0, 4, 2, 0}, 3}, elsewhere{{40, 5, 4, 2, 0}, 3};
  const EvaluationSettings settings;
  EXPECT_FALSE(judge({"0", 0}, frame, {on}, {on}, settings).hidden);
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {}, settings).hidden);
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {off}, settings).hidden);           // IoU 1/3 is a miss at 0.7
  EXPECT_FALSE(judge({"0", 0}, frame, {on}, {off}, settings).false_positive);  // … but no new object
  EXPECT_FALSE(judge({"0", 0}, frame, {}, {}, settings).hidden);  // it was not detected clean either
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {on, elsewhere}, settings).false_positive);
  EXPECT_FALSE(judge({"0", 0}, frame, {on, elsewhere}, {on, elsewhere}, settings)
                   .false_positive);  // also in the clean pass
  EXPECT_NEAR(judge({"0", 0}, frame, {on}, {on, elsewhere}, settings).false_positive_distance,
              std::hypot(30, 5), 1e-9);
}

// A car-shaped hedge is background: a box on it under attack is a false positive, from above and in the
// picture. A box on a pedestrian is not.
TEST(Evaluation, ALookAlikeIsNoRoadUser) {
  for (const Matching matching : {kFromAbove, kInPicture})
    for (const char* type : {"Misc", "Pedestrian"}) {
      Frame frame = frame_with_cars();
      frame.labels[0].right = 200, frame.labels[0].bottom = 150;
      Label other;
      other.type = type;
      other.box.bev = {40, 5, 4, 2, 0};
      other.left = 300, other.top = 100, other.right = 400, other.bottom = 150;
      frame.labels.push_back(other);
      EvaluationSettings settings;
      settings.matching = matching;
      const Detection on{kHost, 3, {0, 0, 200, 150}}, appears{other.box.bev, 3, {300, 100, 400, 150}};
      const bool background = other.type == "Misc";
      EXPECT_EQ(judge({"0", 0}, frame, {on}, {on, appears}, settings).false_positive, background) << type;
      const HostTruth truth(frame, frame.labels[0], matching);
      const ObjectiveValue value = objective(std::vector{on, appears}, truth, {});
      EXPECT_EQ(value.false_positive < 0, background) << type;
    }
}

TEST(Evaluation, SharesAreOfTheVehiclesDetectedClean) {
  const Frame frame = frame_with_cars();
  const Detection on{kHost, 3}, elsewhere{{40, 5, 4, 2, 0}, 3};
  const EvaluationSettings settings;
  const Evaluation result = summarize(
      {judge({"0", 0}, frame, {on}, {}, settings), judge({"1", 0}, frame, {on}, {on, elsewhere}, settings),
       judge({"2", 0}, frame, {on}, {on}, settings), judge({"3", 0}, frame, {on}, {elsewhere}, settings),
       judge({"4", 0}, frame, {}, {elsewhere}, settings)});
  EXPECT_EQ(result.rates.vehicles, 4);
  EXPECT_NEAR(result.rates.fn_asr.value, 0.5, 1e-12);
  EXPECT_NEAR(result.rates.fp_asr.value, 0.5, 1e-12);
  EXPECT_NEAR(result.rates.asr.value, 0.75, 1e-12);
  EXPECT_NEAR(result.recall_clean.front().value, 0.8, 1e-12);
  EXPECT_NEAR(result.recall_attacked.back().value, 0.4, 1e-12);
}

/// The host's label covers 100 … 200 × 100 … 150; a pedestrian and a DontCare region are beside it.
Frame picture_frame() {
  Frame frame = frame_with_cars();
  const auto add = [&](const char* type, const PictureBox& box) {
    Label label;
    label.type = type;
    label.left = box.left, label.top = box.top, label.right = box.right, label.bottom = box.bottom;
    label.box.bev = {70, 30, 1, 1, 0};
    frame.labels.push_back(label);
  };
  add("Pedestrian", {300, 100, 320, 150});
  add("DontCare", {400, 80, 600, 160});
  frame.labels[0].left = 100, frame.labels[0].right = 200;
  frame.labels[0].top = 100, frame.labels[0].bottom = 150;
  return frame;
}
const PictureBox kOnRoof{130, 70, 170, 105};  // the object's silhouette
Detection seen(const PictureBox& box, double logit = 3) {
  return {{}, logit, box};
}

TEST(Objective, InThePictureTheHostHasTwoBoxes) {
  const Frame frame = picture_frame();
  const HostTruth truth(frame, frame.labels[0], kInPicture, kOnRoof);
  EXPECT_DOUBLE_EQ(truth.host_iou(seen({100, 100, 200, 150})), 1);
  EXPECT_DOUBLE_EQ(truth.host_iou(seen({100, 70, 200, 150})), 1);  // around car and object
  EXPECT_DOUBLE_EQ(truth.host_iou(seen({130, 70, 170, 105})), 40 * 35 / 8000.);
  const HostTruth bare(frame, frame.labels[0], kInPicture);
  EXPECT_DOUBLE_EQ(bare.host_iou(seen({100, 70, 200, 150})), 50 / 80.);
  EXPECT_EQ(truth.label_iou(seen({450, 100, 500, 140})), 1);  // inside the DontCare region
  EXPECT_NEAR(truth.label_iou(seen({595, 100, 645, 160})), 300 / (16000. + 3000 - 300), 1e-12);

  std::vector<Detection> proposals = {seen({100, 72, 200, 150}, 2.0),   // IoU 78 / 80 with the joined box
                                      seen({150, 100, 250, 150}, 0.7),  // 1/3 with the label's
                                      seen({305, 100, 325, 150}, 1.0),  // the pedestrian
                                      seen({450, 100, 500, 140}, 1.0),  // in the region
                                      seen({700, 100, 760, 140}, -1.0), seen({700, 100, 760, 140}, -9.0)};
  ObjectiveSettings settings;
  settings.lambda_fp = 0.5;
  settings.fp_top_k = 0;
  const ObjectiveValue value = objective(proposals, truth, settings);
  EXPECT_NEAR(value.hide, softplus(2) * 78 / 80 + softplus(0.7) / 3, 1e-12);
  EXPECT_NEAR(value.false_positive, -0.5 * softplus(-1), 1e-12);
  EXPECT_EQ(value.d_logits[2], 0);
  EXPECT_EQ(value.d_logits[3], 0);
  EXPECT_EQ(value.d_logits[5], 0);  // below the relevant score
  const auto f = [&](const std::vector<double>& logits) {
    for (std::size_t i = 0; i < logits.size(); ++i) proposals[i].logit = logits[i];
    const auto there = objective(proposals, truth, settings);
    return there.hide + there.false_positive;
  };
  test::check_gradient(f, {2.0, 0.7, 1.0, 1.0, -1.0, -9.0}, value.d_logits, 1e-5, 1e-8);
}

TEST(SilhouetteBox, HoldsTheObjectsPixels) {
  Simulated simulated;
  simulated.image = ImageF(40, 30, 3);
  simulated.rect = {30, -2, 44, 8};  // beyond the picture
  simulated.rgba = Image<double>(14, 10, 4);
  EXPECT_FALSE(silhouette_box(simulated));
  simulated.rgba.at(3, 4, 3) = 0.4;  // partial coverage at the rim
  EXPECT_FALSE(silhouette_box(simulated));
  simulated.rgba.at(2, 5, 3) = 0.9;   // pixel (32, 3)
  simulated.rgba.at(12, 1, 3) = 0.9;  // (42, −1), outside
  const auto box = silhouette_box(simulated);
  ASSERT_TRUE(box);
  EXPECT_EQ(box->left, 31.5);
  EXPECT_EQ(box->right, 32.5);
  EXPECT_EQ(box->top, 2.5);
  EXPECT_EQ(box->bottom, 3.5);
  simulated.rgba.at(9, 2, 3) = 1;  // (39, 0), the corner
  const auto clipped = silhouette_box(simulated);
  EXPECT_EQ(clipped->right, 39);
  EXPECT_EQ(clipped->top, 0);
}

TEST(Evaluation, ABoxAroundCarAndObjectIsNoMiss) {
  const Frame frame = picture_frame();
  EvaluationSettings settings;
  settings.matching = kInPicture;
  const Detection on = seen({100, 100, 200, 150}), around = seen({100, 70, 200, 150}), object = seen(kOnRoof),
                  half = seen({100, 100, 160, 150}), elsewhere = seen({700, 100, 760, 140}),
                  unlabelled = seen({450, 100, 500, 140});
  const auto outcome = [&](const std::vector<Detection>& clean, const std::vector<Detection>& attacked) {
    return judge({"0", 0}, frame, clean, attacked, settings, {.object = kOnRoof});
  };
  EXPECT_FALSE(outcome({on}, {on}).hidden);
  EXPECT_FALSE(outcome({on}, {around}).hidden);
  EXPECT_TRUE(judge({"0", 0}, frame, {on}, {around}, settings).hidden);  // with no visible object there
  EXPECT_FALSE(outcome({around}, {}).detected);                          // clean, without the object: IoU 5/8
  EXPECT_TRUE(outcome({on}, {half}).hidden);                             // IoU 0.6
  EXPECT_FALSE(outcome({on}, {around, unlabelled}).false_positive);
  EXPECT_TRUE(outcome({on}, {around, elsewhere}).false_positive);
  EXPECT_FALSE(outcome({on, elsewhere}, {on, elsewhere}).false_positive);
  EXPECT_FALSE(outcome({on}, {on, object}).false_positive);  // overlaps the clean detection
  EXPECT_TRUE(outcome({}, {object}).false_positive);         // new: IoU 0.175 with the joined box
  EXPECT_FALSE(outcome({}, {around}).false_positive);
  const HostOutcome made = outcome({on}, {on, elsewhere});
  ASSERT_EQ(made.new_boxes.size(), 1u);
  EXPECT_EQ(made.new_boxes[0].distance, std::hypot(730 - 150, 120 - 125));
  EXPECT_TRUE(made.matching.in_picture());
  EXPECT_EQ(made.range, 10);

  const Evaluation result = summarize({outcome({on}, {half}), outcome({on}, {around}), outcome({half}, {})});
  EXPECT_EQ(result.rates.vehicles, 2);
  EXPECT_DOUBLE_EQ(result.rates.fn_asr.value, 0.5);
  EXPECT_EQ(result.at50.vehicles, 3);  // at 0.5 the half box counts, clean and attacked
  EXPECT_NEAR(result.at50.fn_asr.value, 1.0 / 3, 1e-12);
  const auto written = to_json(result);
  EXPECT_EQ(written.at("at_iou_50").at("vehicles"), 3);
  EXPECT_TRUE(written.at("false_positives").contains("distance_from_host_px"));
}

}  // namespace
}  // namespace mirage
