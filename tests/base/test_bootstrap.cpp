// The bootstrap where its distribution is known.
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "base/binomial.h"
#include "base/bootstrap.h"
#include "base/crossed_bootstrap.h"
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

TEST(Bootstrap, OneFrameIsNotCertaintyEither) {
  // One frame of four vehicles with one hidden says little of other frames.
  const std::vector<ClusterSums> one{{1, 4}};
  const Interval interval = bootstrap_interval(one);
  EXPECT_EQ(interval.value, 0.25);
  EXPECT_LT(interval.low, 1e-5);
  EXPECT_GT(interval.high, 0.9);
  const std::vector<ClusterSums> alike(20, {1, 2});
  EXPECT_NEAR(bootstrap_interval(alike).low, 0.2720, 5e-5);  // Clopper and Pearson's of 10 in 20
  EXPECT_NEAR(bootstrap_interval(alike).high, 0.7280, 5e-5);
}

TEST(Binomial, TheBetaDistributionIsTheBinomialSum) {
  // I_p(k, n − k + 1) = P(Binomial(n, p) ≥ k).
  const int n = 17;
  for (const double p : {0.01, 0.2, 0.5, 0.83, 0.999}) {
    double above = 1, weight = std::pow(1 - p, n);
    for (int k = 1; k <= n; ++k) {
      above -= weight;
      weight *= (n - k + 1.0) / k * p / (1 - p);
      EXPECT_NEAR(regularized_beta(p, k, n - k + 1), above, 1e-11) << p << " " << k;
    }
  }
  EXPECT_EQ(regularized_beta(0, 2, 3), 0);
  EXPECT_EQ(regularized_beta(1, 2, 3), 1);
  EXPECT_NEAR(regularized_beta(0.3, 1, 1), 0.3, 1e-14);
  EXPECT_NEAR(regularized_beta(0.25, 0.5, 0.5), 1.0 / 3, 1e-12);  // arcsine law
}

TEST(Binomial, IntervalsAreThoseOfTheTables) {
  const auto of = [](double k, double n) { return binomial_interval(k, n); };
  EXPECT_NEAR(of(3, 10).low, 0.0667395, 1e-6);
  EXPECT_NEAR(of(3, 10).high, 0.6524529, 1e-6);
  EXPECT_EQ(of(0, 10).low, 0);
  EXPECT_NEAR(of(0, 10).high, 0.3084971, 1e-6);
  EXPECT_NEAR(of(10, 10).low, 0.6915029, 1e-6);
  EXPECT_EQ(of(10, 10).high, 1);
  // In between it runs on.
  double low = -1, high = 0;
  for (double k = 0; k <= 5; k += 0.125) {
    EXPECT_GE(of(k, 5).low, low);
    EXPECT_GT(of(k, 5).high + (k >= 5), high);
    low = of(k, 5).low, high = of(k, 5).high;
  }
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

TEST(Bootstrap, SeveralRatiosAtOnceAreEachOnesOwn) {
  std::vector<double> denominators;
  std::vector<std::vector<double>> numerators(4);
  RandomStream random(3, "several ratios");
  for (int i = 0; i < 30; ++i) {
    const int n = i % 6 == 0 ? 0 : 1 + random.below(4);
    denominators.push_back(n);
    numerators[0].push_back(n > 0 ? random.below(n + 1) : 0);
    numerators[1].push_back(0);
    numerators[2].push_back(n);
    numerators[3].push_back(n > 0 ? random.below(n + 1) : 0);
  }
  const std::vector<Interval> all = bootstrap_intervals(denominators, numerators);
  ASSERT_EQ(all.size(), 4u);
  for (std::size_t k = 0; k < 4; ++k) {
    std::vector<ClusterSums> clusters;
    for (std::size_t i = 0; i < 30; ++i) clusters.push_back({numerators[k][i], denominators[i]});
    const Interval alone = bootstrap_interval(clusters);
    EXPECT_EQ(all[k].value, alone.value) << k;
    EXPECT_EQ(all[k].low, alone.low) << k;
    EXPECT_EQ(all[k].high, alone.high) << k;
  }
  EXPECT_EQ(bootstrap_intervals({}, numerators).front().high, 1);
}

TEST(Quantile, IsAnOrderStatistic) {
  EXPECT_EQ(quantile({3, 1, 2, 5, 4}, 0.5), 3);
  EXPECT_EQ(quantile({3, 1, 2, 4}, 0.5), 2);
  EXPECT_EQ(quantile({7}, 0.9), 7);
  EXPECT_EQ(quantile({1, 2, 3, 4, 5, 6, 7, 8, 9, 10}, 0.9), 9);
  EXPECT_EQ(quantile({2, 1}, 0), 1);
  EXPECT_EQ(quantile({2, 1}, 1), 2);
}

TEST(BootstrapDifference, OfIndependentSharesIsAsWideAsBothTogether) {
  std::vector<PairedSums> clusters;
  RandomStream random(5, "independent shares");
  for (int i = 0; i < 400; ++i)
    clusters.push_back({{random.uniform() < 0.5 ? 1.0 : 0.0, 1}, {random.uniform() < 0.3 ? 1.0 : 0.0, 1}});
  const Interval difference = bootstrap_difference(clusters);
  EXPECT_NEAR(difference.value, 0.2, 0.1);
  const double deviation = std::sqrt((0.25 + 0.21) / 400);
  EXPECT_NEAR(difference.high - difference.low, 2 * 1.96 * deviation, 0.015);
}

TEST(BootstrapDifference, PairsAreDrawnTogether) {
  // b fails wherever a does but in five clusters: each share is uncertain, the difference is 0.05 of them.
  std::vector<PairedSums> clusters(100, {{0, 1}, {0, 1}});
  for (std::size_t i = 0; i < 50; ++i) clusters[i] = {{1, 1}, {1, 1}};
  for (std::size_t i = 50; i < 55; ++i) clusters[i].a.numerator = 1;
  const Interval difference = bootstrap_difference(clusters);
  EXPECT_NEAR(difference.value, 0.05, 1e-12);
  EXPECT_NEAR(difference.low, binomial_quantile(100, 0.05, 0.025) / 100.0, 0.0101);
  EXPECT_NEAR(difference.high, binomial_quantile(100, 0.05, 0.975) / 100.0, 0.0101);
}

TEST(BootstrapDifference, WithoutSpreadAdmitsTheUnseen) {
  const std::vector<PairedSums> equal(40, {{1, 2}, {1, 2}});
  const Interval difference = bootstrap_difference(equal);
  EXPECT_EQ(difference.value, 0);
  EXPECT_NEAR(difference.high, 1 - std::pow(0.025, 1 / 40.0), 1e-12);
  EXPECT_EQ(difference.low, -difference.high);
  EXPECT_EQ(bootstrap_difference({}).high, 1);
  EXPECT_EQ(bootstrap_difference(std::vector<PairedSums>(3, {{1, 1}, {0, 0}})).low, -1);
}

TEST(BootstrapStatistic, UndefinedDrawsMakeItOpen) {
  // Defined only where the first of two clusters is drawn: three draws in four, too few for 95 %.
  const Interval interval =
      bootstrap_statistic(2, [](std::span<const int> drawn) { return drawn[0] > 0 ? 1.0 : std::nan(""); });
  EXPECT_EQ(interval.value, 1);
  EXPECT_TRUE(std::isinf(interval.low) && std::isinf(interval.high));
}

/// Shares of 40 vehicles under each of `runs` attacks, some of which are better than others: the logit of
/// being hidden is the sum of the vehicle's own, the run's own and −0.4.
std::map<CrossingName, ClusterSums> crossed_outcomes(int trial, int runs, double spread_of_runs) {
  RandomStream random(11, "crossed outcomes", static_cast<std::uint64_t>(trial));
  std::vector<double> of_run, of_vehicle;
  for (int r = 0; r < runs; ++r) of_run.push_back(spread_of_runs * random.normal());
  for (int v = 0; v < 40; ++v) of_vehicle.push_back(random.normal());
  std::map<CrossingName, ClusterSums> sums;
  for (int r = 0; r < runs; ++r)
    for (std::size_t v = 0; v < of_vehicle.size(); ++v) {
      if (random.uniform() < 0.2) continue;  // learned on, so not judged
      const double logit = -0.4 + of_run[static_cast<std::size_t>(r)] + of_vehicle[v];
      sums[{"vehicle " + std::to_string(v), r}] = {random.uniform() < 1 / (1 + std::exp(-logit)) ? 1.0 : 0.0,
                                                   1};
    }
  return sums;
}

std::vector<ClusterSums> over_runs(const std::map<CrossingName, ClusterSums>& sums) {
  std::map<std::string, ClusterSums> clusters;
  for (const auto& [name, one] : sums) {
    clusters[name.first].numerator += one.numerator;
    clusters[name.first].denominator += one.denominator;
  }
  std::vector<ClusterSums> list;
  for (const auto& [name, one] : clusters) list.push_back(one);
  return list;
}

TEST(CrossedBootstrap, CoversWhatRunsDifferBy) {
  // The truth: the share over all vehicles and all runs there could be.
  double truth = 0;
  for (int trial = 1000; trial < 1400; ++trial) {
    ClusterSums all;
    for (const ClusterSums& one : over_runs(crossed_outcomes(trial, 5, 1.2)))
      all.numerator += one.numerator, all.denominator += one.denominator;
    truth += all.numerator / all.denominator / 400;
  }
  constexpr int kTrials = 100;
  int covered = 0, covered_by_vehicles_alone = 0;
  BootstrapSettings settings;
  settings.replicates = 400;
  for (int trial = 0; trial < kTrials; ++trial) {
    const auto sums = crossed_outcomes(trial, 5, 1.2);
    const Interval crossed = crossed_interval(sums, settings),
                   alone = bootstrap_interval(over_runs(sums), settings);
    EXPECT_DOUBLE_EQ(crossed.value, alone.value);
    covered += crossed.low <= truth && truth <= crossed.high;
    covered_by_vehicles_alone += alone.low <= truth && truth <= alone.high;
  }
  RecordProperty("covered", covered);
  RecordProperty("covered_by_vehicles_alone", covered_by_vehicles_alone);
  EXPECT_GE(covered, 0.87 * kTrials);  // five runs are few: percentiles have no Student's t
  EXPECT_LT(covered_by_vehicles_alone, 0.7 * kTrials) << "the control: the runs' spread is left out";
}

TEST(CrossedBootstrap, IsTheOtherWithOneRun) {
  const auto sums = crossed_outcomes(0, 1, 1);
  std::map<CrossingName, PairedSums> pairs;
  std::vector<PairedSums> list;
  for (const auto& [name, one] : sums) pairs[name] = {one, {1 - one.numerator, 1}};
  for (const auto& [name, one] : pairs) list.push_back(one);
  const Interval a = crossed_interval(sums), b = bootstrap_interval(over_runs(sums));
  EXPECT_EQ(a.low, b.low);
  EXPECT_EQ(a.high, b.high);
  const Interval c = crossed_difference(pairs), d = bootstrap_difference(list);
  EXPECT_EQ(c.low, d.low);
  EXPECT_EQ(c.high, d.high);
}

TEST(CrossedBootstrap, MoreRunsOfNothingShowNoMoreVehicles) {
  std::map<CrossingName, ClusterSums> sums;
  for (int r = 0; r < 5; ++r)
    for (int v = 0; v < 20; ++v) sums[{std::to_string(v), r}] = {0, 1};
  EXPECT_NEAR(crossed_interval(sums).high, 0.16843347, 1e-7);  // Clopper and Pearson's, 0 of 20
  EXPECT_EQ(crossed_interval({}).high, 1);
}

TEST(CrossedBootstrap, PairsOfARunAreDrawnTogether) {
  // Arm a is arm b and five points more in every run: however much runs differ, the difference does not.
  std::map<CrossingName, PairedSums> pairs;
  for (int r = 0; r < 4; ++r)
    for (int v = 0; v < 30; ++v) {
      const double share = 0.2 * r;
      pairs[{std::to_string(v), r}] = {{100 * share + 5, 100}, {100 * share, 100}};
    }
  const Interval together = crossed_difference(pairs);
  EXPECT_NEAR(together.value, 0.05, 1e-12);
  EXPECT_LT(together.high - together.low, 0.25);  // none drawn, so what 30 vehicles may not have shown
  std::map<CrossingName, PairedSums> crooked = pairs;
  for (auto& [name, one] : crooked)
    if (name.second % 2 == 1) one.a.numerator = 0;  // now the arms disagree by run
  const Interval apart = crossed_difference(crooked);
  EXPECT_GT(apart.high - apart.low, 0.3);
}

}  // namespace
}  // namespace mirage
