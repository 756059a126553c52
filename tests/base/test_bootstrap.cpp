// The bootstrap where its distribution is known.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "base/bootstrap.h"
#include "base/random.h"

namespace mirage {
namespace {

/// Smallest k with P(Binomial(n, p) ≤ k) ≥ q.
int binomial_quantile(int n, double p, double q) {
  double below = 0;
  for (int k = 0; k <= n; ++k) {
    below += std::exp(std::lgamma(n + 1) - std::lgamma(k + 1) - std::lgamma(n - k + 1) + k * std::log(p) +
                      (n - k) * std::log1p(-p));
    if (below >= q) return k;
  }
  return n;
}

TEST(Bootstrap, OneVehicleAFrameIsABinomialDistribution) {
  // Drawing n of n yes-or-no clusters with replacement gives Binomial(n, share) yeses exactly.
  std::vector<ClusterSums> clusters(100, {0, 1});
  for (int i = 0; i < 30; ++i) clusters[static_cast<std::size_t>(i)].numerator = 1;
  const Interval interval = bootstrap_interval(clusters);
  EXPECT_DOUBLE_EQ(interval.value, 0.3);
  EXPECT_NEAR(interval.low, binomial_quantile(100, 0.3, 0.025) / 100.0, 0.0101);
  EXPECT_NEAR(interval.high, binomial_quantile(100, 0.3, 0.975) / 100.0, 0.0101);
}

TEST(Bootstrap, VehiclesOfOneFrameCountAsOneDraw) {
  // Ten equal vehicles a frame say no more than one, and the interval is that of the frames.
  std::vector<ClusterSums> alone(40, {0, 1}), crowded(40, {0, 10});
  for (std::size_t i = 0; i < 10; ++i) alone[i].numerator = 1, crowded[i].numerator = 10;
  const Interval a = bootstrap_interval(alone), b = bootstrap_interval(crowded);
  EXPECT_DOUBLE_EQ(a.low, b.low);
  EXPECT_DOUBLE_EQ(a.high, b.high);
  EXPECT_GT(a.high - a.low, 0.2);
}

TEST(Bootstrap, TheSameSeedGivesTheSameInterval) {
  const std::vector<ClusterSums> clusters{{1, 4}, {0, 2}, {3, 3}, {2, 9}, {0, 0}};
  const Interval a = bootstrap_interval(clusters), b = bootstrap_interval(clusters);
  EXPECT_EQ(a.low, b.low);
  EXPECT_EQ(a.high, b.high);
  EXPECT_NEAR(a.value, 6.0 / 18, 1e-15);
  EXPECT_LE(a.low, a.value);
  EXPECT_GE(a.high, a.value);
}

TEST(Bootstrap, NoneAtAllIsNotCertainty) {
  // Clopper and Pearson's upper limit for 0 of n: 1 − 0.025^(1/n).
  const std::vector<ClusterSums> none(20, {0, 3});
  EXPECT_EQ(bootstrap_interval(none).low, 0);
  EXPECT_NEAR(bootstrap_interval(none).high, 0.16843347, 1e-7);
  const std::vector<ClusterSums> all(20, {3, 3});
  EXPECT_NEAR(bootstrap_interval(all).low, 1 - 0.16843347, 1e-7);
  EXPECT_EQ(bootstrap_interval(all).high, 1);
  const Interval nothing = bootstrap_interval({});
  EXPECT_EQ(nothing.low, 0);
  EXPECT_EQ(nothing.high, 1);
}

TEST(Bootstrap, CoversTheTruthAboutAsOftenAsItSays) {
  int covered = 0;
  constexpr int kTrials = 200;
  for (int trial = 0; trial < kTrials; ++trial) {
    RandomStream random(7, "bootstrap coverage", static_cast<std::uint64_t>(trial));
    std::vector<ClusterSums> clusters(40);
    for (ClusterSums& cluster : clusters) {
      cluster.denominator = 1 + random.below(4);
      for (int i = 0; i < static_cast<int>(cluster.denominator); ++i)
        cluster.numerator += random.uniform() < 0.4;
    }
    BootstrapSettings settings;
    settings.replicates = 1000;
    const Interval interval = bootstrap_interval(clusters, settings);
    covered += interval.low <= 0.4 && 0.4 <= interval.high;
  }
  EXPECT_GE(covered, 0.88 * kTrials);
  EXPECT_LE(covered, 0.995 * kTrials);
}

}  // namespace
}  // namespace mirage
