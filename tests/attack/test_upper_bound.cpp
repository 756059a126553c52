// Upper bounds of shares: the textbook values for single trials, and their coverage in clusters.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "attack/host_outcome.h"

namespace mirage {
namespace {

TEST(ShareBound, OfSingleTrialsIsClopperAndPearsons) {
  const std::vector<double> none(59, 0.0);
  EXPECT_NEAR(share_bound(none, true).high, 1 - std::pow(0.05, 1.0 / 59), 1e-12);
  EXPECT_NEAR(share_bound(none, false).high, 1 - std::pow(0.05 / M_E, 1.0 / 59), 1e-12);
  std::vector<double> one = none;
  one[3] = 1;
  EXPECT_NEAR(share_bound(one, true).high, 0.0779, 1e-4);  // Clopper and Pearson's table: 1 of 59
  const double whole = share_bound(one, false).high;
  one[3] = 0.5;  // half a success counts as one
  EXPECT_DOUBLE_EQ(share_bound(one, false).high, whole);
  EXPECT_GT(share_bound(one, false).high, share_bound(none, false).high);
  EXPECT_EQ(share_bound({}, true).high, 1);
  EXPECT_EQ(share_bound(std::vector<double>(5, 1.0), true).high, 1);
  EXPECT_EQ(clusters_for(0.05, 0, true), 59);
  EXPECT_EQ(clusters_for(0.01, 0, true), 299);
  EXPECT_EQ(clusters_for(0.05, 0, false), 78);
  EXPECT_GT(clusters_for(0.05, 0.02, true), 150);
  EXPECT_TRUE(std::isinf(clusters_for(0.05, 0.05, true)));
}

TEST(ShareBound, HoldsInClusters) {
  std::mt19937_64 random(7);
  int held = 0;
  constexpr int kTrials = 2000;
  for (int t = 0; t < kTrials; ++t) {
    const double share = std::uniform_real_distribution<>(0.01, 0.3)(random);
    std::vector<double> shares;
    for (int c = 0; c < 40; ++c) {  // outcomes are independent in odd clusters, all alike in even ones
      const int size = std::uniform_int_distribution<>(1, 6)(random);
      const double own = c % 2 ? share : (std::bernoulli_distribution(share)(random) ? 1 : 0);
      shares.push_back(std::binomial_distribution<>(size, own)(random) / double(size));
    }
    held += share_bound(shares, false).high >= share;
  }
  EXPECT_GE(held, 0.95 * kTrials);
}

}  // namespace
}  // namespace mirage
