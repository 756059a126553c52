// Extremes of the attack's objective: logits, overlaps, and the number of proposals.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "attack/objective.h"
#include "base/random.h"

namespace mirage {
namespace {

const BevBox kHost{10, 0, 4, 2, 0.3};

TEST(ObjectiveExtremes, LogitsOfPlusMinus1e4) {
  const BevBox elsewhere{40, 8, 4, 2, 0};
  for (double logit : {1e4, 1e300, -1e4, -1e300, 0.}) {
    const std::vector<Detection> proposals{{kHost, logit}, {elsewhere, logit}};
    const ObjectiveValue value = objective(proposals, {kHost, {kHost}}, {});
    EXPECT_TRUE(std::isfinite(value.hide));
    EXPECT_TRUE(std::isfinite(value.false_positive));
    const double score = logit > 0 ? 1 : logit < 0 ? 0 : 0.5;
    EXPECT_NEAR(value.hide, logit > 0 ? logit : logit < 0 ? 0 : std::log(2.), 1e-12 * (1 + std::abs(logit)));
    EXPECT_NEAR(value.d_logits[0], score, 1e-12);
    EXPECT_NEAR(value.d_logits[1], -ObjectiveSettings().lambda_fp * score, 1e-12);
    EXPECT_EQ(proposals[0].score(), score);
  }
  // The derivative of softplus on both sides of where exp overflows and underflows.
  for (double x : {-745., -40., -1., 0., 1., 40., 745.}) {
    const double h = 1e-4, numeric = (softplus(x + h) - softplus(x - h)) / (2 * h);
    EXPECT_NEAR(numeric, Detection({kHost, x}).score(), 1e-7) << x;
  }
}

TEST(ObjectiveExtremes, IouExactlyZeroAndOne) {
  EXPECT_NEAR(iou(kHost, kHost), 1, 1e-15);
  EXPECT_EQ(iou(kHost, {200, 0, 4, 2, 0.3}), 0);
  const BevBox square{0, 0, 2, 2, 0};
  EXPECT_EQ(iou(square, {2, 0, 2, 2, 0}), 0);  // edge to edge
  EXPECT_EQ(iou(square, {2, 2, 2, 2, 0}), 0);  // corner to corner
  EXPECT_EQ(iou(square, {0, 0, 0, 2, 0}), 0);  // no area
  double worst = 0;
  RandomStream random(1, "iou one");
  for (int i = 0; i < 20000; ++i) {
    const double scale = std::pow(10, random.uniform(-6, 4)), far = std::pow(10, random.uniform(-3, 5));
    const BevBox box{random.uniform(-far, far), random.uniform(-far, far), scale * random.uniform(.1, 5),
                     scale * random.uniform(.1, 5), random.uniform(-7, 7)};
    const double same = iou(box, box);
    worst = std::max(worst, std::abs(same - 1));
    ASSERT_LE(same, 1);
    if (std::max(box.length, box.width) > 1000 || std::hypot(box.x, box.y) > 1e5)
      continue;  // no box of a detector's
    ASSERT_GT(objective(std::vector<Detection>{{box, 2}}, {box, {box}}, {}).hide, 0);
  }
  EXPECT_LE(worst, 1e-12);
  std::printf("IoU of a box with itself: 1 to %.1e\n", worst);
}

TEST(ObjectiveExtremes, NoProposalAtAll) {
  const ObjectiveValue value = objective({}, {kHost, {kHost}}, {});
  EXPECT_EQ(value.hide, 0);
  EXPECT_EQ(value.false_positive, 0);
  EXPECT_TRUE(value.d_logits.empty());
  EXPECT_TRUE(suppress({}).empty());
}

TEST(ObjectiveExtremes, TenThousandProposals) {
  RandomStream random(2, "ten thousand proposals");
  std::vector<Detection> proposals;
  for (int i = 0; i < 10000; ++i)
    proposals.push_back({{random.uniform(0, 70), random.uniform(-40, 40), random.uniform(3, 5),
                          random.uniform(1, 2), random.uniform(-3, 3)},
                         random.uniform(-20, 20)});
  std::vector<ObjectBoxes> truth{kHost};
  for (int i = 0; i < 40; ++i)
    truth.push_back(BevBox{random.uniform(0, 70), random.uniform(-40, 40), 4, 2, 0});
  ObjectiveSettings by_score;
  by_score.fp_top_k = 0;  // which does not depend on the others
  const ObjectiveValue value = objective(proposals, {kHost, truth}, by_score);
  EXPECT_TRUE(std::isfinite(value.hide + value.false_positive));
  EXPECT_GT(value.hide, 0);
  EXPECT_LT(value.false_positive, 0);
  // One after the other gives the same.
  double hide = 0;
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const auto one = objective({&proposals[i], 1}, {kHost, truth}, by_score);
    hide += one.hide;
    EXPECT_EQ(one.d_logits[0], value.d_logits[i]);
  }
  EXPECT_NEAR(hide, value.hide, 1e-9 * value.hide);
  const auto kept = suppress(proposals, 0.1);
  EXPECT_GT(kept.size(), 100u);
  for (std::size_t i = 0; i + 1 < kept.size(); ++i) EXPECT_GE(kept[i].logit, kept[i + 1].logit);
  // All on one spot: the best is left.
  for (Detection& proposal : proposals) proposal.box.bev = kHost;
  EXPECT_EQ(suppress(proposals).size(), 1u);
}

}  // namespace
}  // namespace mirage
