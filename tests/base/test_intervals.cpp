// Intervals over clusters: their coverage for known truths, and their limits for few clusters.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>
#include <random>
#include <string>

#include "base/intervals.h"
#include "base/random.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr std::array<int, 7> kSizes = {1, 1, 2, 3, 4, 6, 10};  // cluster sizes

/// Clusters with their own shares, with mean `share` and intra-cluster correlation `within` (beta-binomial).
ClusteredShare clusters_of(std::mt19937_64& random, int clusters, double share, double within) {
  ClusteredShare result;
  for (int c = 0; c < clusters; ++c) {
    double own = share;
    if (within > 0) {
      const double a = std::gamma_distribution<>(share * (1 - within) / within)(random),
                   b = std::gamma_distribution<>((1 - share) * (1 - within) / within)(random);
      own = a + b > 0 ? a / (a + b) : std::bernoulli_distribution(share)(random);
    }
    const int size = kSizes[std::uniform_int_distribution<std::size_t>(0, kSizes.size() - 1)(random)];
    for (int i = 0; i < size; ++i) result.add(std::to_string(c), std::bernoulli_distribution(own)(random));
  }
  return result;
}

TEST(Intervals, SharesAreCoveredAsOftenAsSaid) {
  for (const int clusters : {5, 7, 20, 100})
    for (const double within : {0.0, 0.3}) {
      std::mt19937_64 random(static_cast<std::uint64_t>(clusters * 10) + (within > 0));
      const int trials = clusters > 50 ? 2000 : 8000;
      int covered = 0;
      for (int t = 0; t < trials; ++t) {
        const double share = std::uniform_real_distribution<>(0.02, 0.5)(random);
        const Interval interval = clusters_of(random, clusters, share, within).interval();
        covered += interval.low <= share && share <= interval.high;
      }
      const double coverage = double(covered) / trials;
      RecordProperty("clusters_" + std::to_string(clusters) + (within > 0 ? "_correlated" : ""),
                     std::to_string(coverage));
      EXPECT_GE(coverage, 0.93) << clusters << " clusters, within " << within;
      EXPECT_LE(coverage, 0.97) << clusters << " clusters, within " << within;
    }
}

TEST(Intervals, DifferencesAreCoveredAsOftenAsSaid) {
  for (const int clusters : {5, 7, 20, 100}) {
    std::mt19937_64 random(static_cast<std::uint64_t>(clusters));
    const int trials = clusters > 50 ? 2000 : 6000;
    int covered = 0;
    for (int t = 0; t < trials; ++t) {
      // Two meshes on the same vehicles: b hides some that a does not, and vice versa.
      const double share = std::uniform_real_distribution<>(0.05, 0.5)(random),
                   lost = std::uniform_real_distribution<>(0.1, 0.6)(random), won = 0.1;
      ClusteredShare a, b;
      for (int c = 0; c < clusters; ++c) {
        const int size = kSizes[std::uniform_int_distribution<std::size_t>(0, kSizes.size() - 1)(random)];
        for (int i = 0; i < size; ++i) {
          const bool hidden = std::bernoulli_distribution(share)(random);
          a.add(std::to_string(c), hidden);
          b.add(std::to_string(c), hidden ? !std::bernoulli_distribution(lost)(random)
                                          : std::bernoulli_distribution(won)(random));
        }
      }
      const double truth = share * lost - (1 - share) * won;
      const Interval interval = share_difference(a, b);
      covered += interval.low <= truth && truth <= interval.high;
    }
    const double coverage = double(covered) / trials;
    RecordProperty("clusters_" + std::to_string(clusters), std::to_string(coverage));
    EXPECT_GE(coverage, 0.93) << clusters;
    EXPECT_LE(coverage, clusters < 20 ? 1 : 0.97) << clusters;  // few clusters: conservative
  }
}

/// `hidden` of 6 vehicles in each of 7 frames, all in different frames.
Interval of_seven_frames(int hidden) {
  ClusteredShare share;
  for (int frame = 0; frame < 7; ++frame)
    for (int i = 0; i < 6; ++i) share.add(std::to_string(frame), i == 0 && frame < hidden);
  return share.interval();
}

TEST(Intervals, OneSuccessMoreNeverLowersABound) {
  Interval before = of_seven_frames(0);
  EXPECT_EQ(before.low, 0);
  EXPECT_GT(before.high, 3.0 / 42);  // rule of three: vehicles of a frame are at most fully correlated
  EXPECT_LT(before.high, 0.2);
  for (int hidden = 1; hidden <= 4; ++hidden) {
    const Interval next = of_seven_frames(hidden);
    EXPECT_GE(next.low, before.low) << hidden;
    EXPECT_GT(next.high, before.high) << hidden;
    before = next;
  }
}

TEST(Intervals, NoneAndAllAreEachOthersMirror) {
  ClusteredShare none, all;
  for (int c = 0; c < 20; ++c) none.add(std::to_string(c), 0), all.add(std::to_string(c), 1);
  const Interval a = none.interval(), b = all.interval();
  EXPECT_EQ(a.low, 0);
  EXPECT_EQ(b.high, 1);
  EXPECT_NEAR(a.high, 1 - b.low, 1e-12);
  // Wilson's with Student's t of 19 degrees: t² / (n + t²), t = 2.0930.
  EXPECT_NEAR(a.high, 4.38066 / 24.38066, 1e-4);
}

TEST(Intervals, WhatCannotBeKnownIsEverything) {
  EXPECT_EQ(ClusteredShare().interval().high, 1);
  ClusteredShare one, other;
  for (int i = 0; i < 100; ++i) one.add("a", i % 2), other.add("b", 1);
  EXPECT_EQ(one.interval().value, 0.5);
  EXPECT_EQ(one.interval().low, 0);
  EXPECT_EQ(one.interval().high, 1);
  EXPECT_EQ(share_difference(one, {}).low, -1);
  EXPECT_EQ(share_difference(one, one).high, 1);
  EXPECT_EQ(share_difference(one, other).low, -1);
  EXPECT_TRUE(std::isinf(one.mean_interval().low));
}

TEST(Intervals, ManyClustersGiveTheNormalInterval) {
  ClusteredShare share;
  for (int c = 0; c < 10000; ++c) share.add(std::to_string(c), c < 3000);
  const Interval interval = share.interval();
  const double reach = 1.96 * std::sqrt(0.3 * 0.7 / 10000);
  EXPECT_NEAR(interval.low, 0.3 - reach, 1e-4);
  EXPECT_NEAR(interval.high, 0.3 + reach, 1e-4);
}

TEST(Intervals, AClusterOfManyIsNoBetterThanOneOfFew) {
  ClusteredShare few, many;
  for (int c = 0; c < 30; ++c)
    for (int i = 0; i < 20; ++i) {
      if (i == 0) few.add(std::to_string(c), c < 9);
      many.add(std::to_string(c), c < 9);  // all vehicles of a frame have the same outcome
    }
  EXPECT_NEAR(few.interval().low, many.interval().low, 0.01);
  EXPECT_NEAR(few.interval().high, many.interval().high, 0.01);
}

TEST(Intervals, MoreMeshesOnAVehicleAreNoMoreVehicles) {
  ClusteredShare once, often;
  for (int c = 0; c < 7; ++c) {
    once.add(std::to_string(c), 0);
    for (int mesh = 0; mesh < 50; ++mesh) often.add(std::to_string(c), 0, 0, 1.0 / 50);
  }
  EXPECT_NEAR(once.interval().high, often.interval().high, 1e-9);
}

TEST(Intervals, WhereNothingDiffersTheRuleOfThreeIsLeft) {
  ClusteredShare a;
  for (int c = 0; c < 100; ++c) a.add(std::to_string(c), c % 3 == 0);
  const Interval difference = share_difference(a, a);
  EXPECT_EQ(difference.value, 0);
  EXPECT_NEAR(difference.high, 0.02, 0.002);  // t · 1 / n
  EXPECT_EQ(difference.low, -difference.high);
}

TEST(Jackknife, IsThatOfAMean) {
  // For a mean, its square is s² / n.
  const std::array<double, 5> values = {1, 2, 4, 8, 9};
  ClusteredShare mean;
  for (std::size_t i = 0; i < values.size(); ++i) mean.add(std::to_string(i), values[i]);
  const Interval interval = mean.mean_interval();
  EXPECT_NEAR(interval.value, 4.8, 1e-12);
  const double s2 = (3.8 * 3.8 + 2.8 * 2.8 + 0.8 * 0.8 + 3.2 * 3.2 + 4.2 * 4.2) / 4;
  EXPECT_NEAR(interval.high - interval.value, 2.776445 * std::sqrt(s2 / 5), 1e-5);
}

TEST(Jackknife, AFigureThatOneClusterAloneHasIsUnknown) {
  const SumsByCrossing sums = {{{"a", 0}, {1, 2}}, {{"b", 0}, {0, 2}}};
  const Estimate ratio = jackknife(
      sums, [](std::span<const double> all) { return all[0] > 0 ? all[1] / all[0] : std::nan(""); });
  EXPECT_EQ(ratio.value, 4);
  EXPECT_TRUE(std::isinf(ratio.variance));
  EXPECT_TRUE(std::isinf(plain_interval(ratio).low));
}

/// 40 vehicles under each of `runs` attacks of different strength. The logit of being hidden is the sum of a
/// vehicle term, a run term and −0.4. Without `by_run` the runs are not recorded.
ClusteredShare crossed_outcomes(int trial, int runs, double spread_of_runs, bool by_run = true) {
  RandomStream random(11, "crossed outcomes", static_cast<std::uint64_t>(trial));
  std::vector<double> of_run, of_vehicle;
  for (int r = 0; r < runs; ++r) of_run.push_back(spread_of_runs * random.normal());
  for (int v = 0; v < 40; ++v) of_vehicle.push_back(random.normal());
  ClusteredShare share;
  for (int r = 0; r < runs; ++r)
    for (std::size_t v = 0; v < of_vehicle.size(); ++v) {
      if (random.uniform() < 0.2) continue;  // in training, so not judged
      const double logit = -0.4 + of_run[as_size(r)] + of_vehicle[v];
      share.add("vehicle " + std::to_string(v), random.uniform() < 1 / (1 + std::exp(-logit)),
                by_run ? r : 0);
    }
  return share;
}

TEST(CrossedIntervals, CoverWhatRunsDifferBy) {
  // The truth: the share over all possible vehicles and runs.
  double truth = 0;
  for (int trial = 1000; trial < 3000; ++trial)
    truth += crossed_outcomes(trial, 5, 1.2, false).interval().value / 2000;
  constexpr int kTrials = 400;
  int covered = 0, covered_by_vehicles_alone = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Interval crossed = crossed_outcomes(trial, 5, 1.2).interval(),
                   alone = crossed_outcomes(trial, 5, 1.2, false).interval();
    EXPECT_DOUBLE_EQ(crossed.value, alone.value);
    covered += crossed.low <= truth && truth <= crossed.high;
    covered_by_vehicles_alone += alone.low <= truth && truth <= alone.high;
  }
  RecordProperty("covered", covered);
  RecordProperty("covered_by_vehicles_alone", covered_by_vehicles_alone);
  EXPECT_GE(covered, 0.92 * kTrials);
  EXPECT_LT(covered_by_vehicles_alone, 0.7 * kTrials) << "the control: the runs' spread is left out";
}

TEST(CrossedIntervals, MoreRunsOfNothingShowNoMoreVehicles) {
  ClusteredShare one, five;
  for (int v = 0; v < 20; ++v) {
    one.add(std::to_string(v), 0);
    for (int r = 0; r < 5; ++r) five.add(std::to_string(v), 0, r);
  }
  EXPECT_NEAR(five.interval().high, one.interval().high, 1e-12);
}

TEST(CrossedIntervals, PairsOfARunAreLeftOutTogether) {
  // Arm a is arm b plus five points in every run: the difference does not vary, however much the runs differ.
  ClusteredShare a, b, crooked;
  for (int r = 0; r < 4; ++r)
    for (int v = 0; v < 30; ++v) {
      const std::string vehicle = std::to_string(v);
      a.add(vehicle, 0.2 * r + 0.05, r);
      b.add(vehicle, 0.2 * r, r);
      crooked.add(vehicle, r % 2 == 1 ? 0 : 0.2 * r + 0.05, r);  // the arms disagree by run
    }
  const Interval together = share_difference(a, b);
  EXPECT_NEAR(together.value, 0.05, 1e-12);
  EXPECT_LT(together.high - together.low, 0.25);  // the allowance for 30 vehicles
  const Interval apart = share_difference(crooked, b);
  EXPECT_GT(apart.high - apart.low, 0.3);
}

TEST(Quantile, IsAnOrderStatistic) {
  EXPECT_EQ(quantile({3, 1, 2, 5, 4}, 0.5), 3);
  EXPECT_EQ(quantile({3, 1, 2, 4}, 0.5), 2);
  EXPECT_EQ(quantile({7}, 0.9), 7);
}

TEST(Intervals, PointsHaveASignUnlessTheyRoundToZero) {
  EXPECT_EQ(signed_points({0.0921, 0.034, 0.16249}), "+9.2 (+3.4 to +16.2)");
  EXPECT_EQ(signed_points({-0.0004, -0.1, 0}), "0.0 (-10.0 to 0.0)");
  EXPECT_EQ(signed_points(0.0006), "+0.1");
  EXPECT_EQ(signed_points(-0.10), "-10.0");
}

TEST(Intervals, TheMediansIntervalHoldsByOrderStatistics) {
  const Interval seven = median_interval({7, 1, 6, 2, 5, 3, 4});
  EXPECT_EQ(seven.value, 4);
  EXPECT_EQ(seven.low, 1);  // two values outside: 1.6 %; four: 12.5 %
  EXPECT_EQ(seven.high, 7);
  const Interval few = median_interval({1, 2, 3, 4});
  EXPECT_EQ(few.value, 2.5);
  EXPECT_TRUE(std::isinf(few.low) && std::isinf(few.high));
  // Coverage of a skewed distribution's median, from 19 values.
  int held = 0;
  for (int i = 0; i < 2000; ++i) {
    RandomStream random(11, "median", static_cast<std::uint64_t>(i));
    std::vector<double> values;
    for (int k = 0; k < 19; ++k) values.push_back(-std::log(1 - random.uniform()));
    const Interval of = median_interval(values);
    held += of.low <= std::log(2.0) && std::log(2.0) <= of.high;
  }
  EXPECT_GE(held, 0.94 * 2000);
  EXPECT_LE(held, 0.985 * 2000);
}

TEST(Clusters, AVehicleIsOneInAllItsFramesAndTheUnknownAreTheirFrames) {
  EXPECT_EQ(cluster_of("000003", 17), cluster_of("000008", 17));
  EXPECT_NE(cluster_of("000003", 17), cluster_of("000003", 18));
  EXPECT_EQ(cluster_of("000003", -1), "000003");
  Clusters clusters;
  clusters.add("000003", -1);
  clusters.add("000003", -1);
  clusters.add("000008", -1);
  EXPECT_EQ(clusters.count().by, "frame");
  EXPECT_EQ(clusters.count().count, 2);
  for (const char* frame : {"000003", "000008", "000009"}) clusters.add(frame, 17);
  EXPECT_EQ(to_json(clusters.count()), (nlohmann::json{{"by", "vehicle"}, {"count", 3}}));
  const nlohmann::json json = to_json(clusters.count());
  EXPECT_EQ(cluster_count_from_json({"file", json, ""}).count, 3);
  EXPECT_EQ(cluster_count_from_json({"file", json, ""}).by, "vehicle");
}

// A vehicle's number is not confused with a frame of the same name.
TEST(Clusters, VehiclesAndFramesOfEqualNumbersAreApart) {
  EXPECT_NE(cluster_of("000017", -1), cluster_of("000003", 17));
}

}  // namespace
}  // namespace mirage
