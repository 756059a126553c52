// Comparisons of two detectors: planted regressions are found, and a detector against itself raises no alarm.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <numeric>
#include <random>

#include "attack/comparison.h"
#include "base/error.h"
#include "support/files.h"

namespace mirage {
namespace {

/// One detector's outcomes on `vehicles` cars, four per frame, under two objects. Each frame has its own
/// share of cars that vanish. The same `world` gives the same cars.
std::vector<HostOutcome> outcomes(int vehicles, std::uint64_t world) {
  std::mt19937_64 random(world);
  std::vector<HostOutcome> hosts;
  double share = 0;
  for (int v = 0; v < vehicles; ++v) {
    if (v % 4 == 0) share = std::uniform_real_distribution<>(0, 0.5)(random);
    const double range = std::uniform_real_distribution<>(5, 60)(random);
    for (int mesh = 0; mesh < 2; ++mesh) {
      HostOutcome host;
      host.id = {"frame" + std::to_string(v / 4), v % 4};
      host.mesh = mesh;
      host.range = range;
      host.kind = "Car";
      host.clean_iou = std::bernoulli_distribution(0.9)(random) ? 0.9 : 0.0;
      host.attacked_iou = std::bernoulli_distribution(share)(random) ? 0.0 : 0.8;
      hosts.push_back(host);
    }
  }
  return hosts;
}

/// The same detector with a share `lost` of its found cars lost, and a share `won` of the others found.
std::vector<HostOutcome> changed(std::vector<HostOutcome> hosts, double lost, double won,
                                 std::uint64_t seed) {
  std::mt19937_64 random(seed);
  for (HostOutcome& host : hosts) {
    const bool there = host.attacked_iou > 0.1;
    if (std::bernoulli_distribution(there ? lost : won)(random)) host.attacked_iou = there ? 0 : 0.8;
  }
  return hosts;
}

const std::vector<std::string> kObjects = {"a.glb", "b.glb"};

TEST(Comparison, FindsAPlantedRegressionOfATwentieth) {
  int found = 0;
  for (std::uint64_t draw = 0; draw < 20; ++draw) {
    const auto first = outcomes(400, draw), second = changed(first, 0.05, 0, 100 + draw);
    const Comparison result = compare_outcomes(first, second, kObjects, false);
    const Interval& difference = result.parts.front().difference;
    found += difference.low > 0;
    EXPECT_LT(difference.value, 0.09);
  }
  std::printf("a planted regression of 5 points is told in %d of 20 draws of 400 vehicles\n", found);
  EXPECT_GE(found, 16);
}

TEST(Comparison, ADetectorThatOnlyTremblesIsNoWorse) {
  int alarms = 0;
  for (std::uint64_t draw = 0; draw < 40; ++draw) {
    const auto world = outcomes(200, 1000 + draw);
    // Both lose 4 % of the found cars. Three of four cars are found, so a gain of 12 % balances that.
    const Comparison result = compare_outcomes(changed(world, 0.04, 0.12, 2000 + draw),
                                               changed(world, 0.04, 0.12, 3000 + draw), kObjects, false);
    alarms += classify(result.parts.front().difference) == DifferenceVerdict::more ||
              classify(result.parts.front().difference) == DifferenceVerdict::less;
  }
  std::printf("a detector against itself: %d alarms in 40 draws\n", alarms);
  EXPECT_LE(alarms, 2);
  const auto first = outcomes(100, 1);
  const Comparison same = compare_outcomes(first, first, kObjects, false);
  EXPECT_EQ(same.parts.front().difference.value, 0);
  EXPECT_TRUE(same.worse.empty());
}

TEST(Comparison, SaysWhatItCouldHaveShown) {
  const auto first = outcomes(200, 5), second = changed(first, 0.05, 0, 6);
  const Comparison result = compare_outcomes(first, second, kObjects, false);
  EXPECT_GT(result.detectable, 0.01);
  EXPECT_LT(result.detectable, 0.1);
  ASSERT_EQ(result.needed.size(), 3u);
  EXPECT_EQ(result.needed[0].vehicles, sample_size(result.parts.front().vehicles, result.detectable, 0.02));
  EXPECT_NEAR(
      static_cast<double>(*result.needed[0].vehicles) / static_cast<double>(*result.needed[1].vehicles), 6.25,
      0.6);  // (5 / 2)², with numbers that are rounded up
  // A difference of that size is detected in about 80 % of the draws.
  int told_in = 0;
  const double lost = result.detectable / 0.75;
  for (std::uint64_t draw = 0; draw < 200; ++draw) {
    const auto world = outcomes(200, 10000 + draw);
    told_in += compare_outcomes(world, changed(world, lost, 0, 20000 + draw), kObjects, false)
                   .parts.front()
                   .difference.low > 0;
  }
  EXPECT_GT(told_in, 120);
  const Comparison nothing =
      compare_outcomes({}, {}, kObjects, false);  // without vehicles no number of them can be derived
  EXPECT_EQ(nothing.detectable, 1);
  for (const auto& [difference, vehicles] : nothing.needed) EXPECT_FALSE(vehicles) << difference;
}

TEST(Comparison, CountsVehiclesThatBothFindOnce) {
  std::vector<HostOutcome> first(4), second;
  for (int i = 0; i < 4; ++i) {
    first[as_size(i)].id = {"f" + std::to_string(i / 2), i / 2};
    first[as_size(i)].mesh = i % 2;
    first[as_size(i)].range = 30 - 10 * (i / 2);
    first[as_size(i)].clean_iou = first[as_size(i)].attacked_iou = 0.9;
  }
  second = first;
  second[0].attacked_iou = 0;  // f0 is lost under the first object, f1 under both
  second[2].attacked_iou = second[3].attacked_iou = 0;
  const Comparison result = compare_outcomes(first, second, kObjects, true);
  EXPECT_EQ(result.hosts, 2);
  EXPECT_EQ(result.parts.front().vehicles, 2);
  EXPECT_DOUBLE_EQ(result.parts.front().difference.value, 0.75);
  for (const ComparedPart& part : result.parts)
    if (part.by == "range") {
      EXPECT_EQ(part.vehicles, 1) << part.name;  // they are at 20 and 30 m
    }
  ASSERT_EQ(result.worse.size(), 3u);
  EXPECT_EQ(result.worse[0].id.frame, "f1");  // the nearest of them
  EXPECT_EQ(result.worse[2].object, "a.glb");
  ASSERT_TRUE(result.own);  // the first under its object a: 0 of 2; the second under b: 1 of 2
  EXPECT_DOUBLE_EQ(result.own->difference.value, 0.5);
  second[0].clean_iou = second[1].clean_iou = 0;
  EXPECT_EQ(compare_outcomes(first, second, kObjects, false).parts.front().vehicles, 1);
}

// The second detector loses the same vehicles in both rows, so the intervals are the same.
TEST(Comparison, ARowOfTheOwnObjectsIsAsSureAsTheRowOfEachObject) {
  const auto first = outcomes(40, 8), second = changed(first, 0.2, 0.05, 9);
  const Comparison result = compare_outcomes(first, second, kObjects, true);
  const auto row = [&](const std::string& object) {
    return *std::ranges::find_if(
        result.parts, [&](const ComparedPart& part) { return part.by == "object" && part.name == object; });
  };
  ASSERT_TRUE(result.own);
  const ComparedPart a = row("a.glb"), b = row("b.glb");
  EXPECT_EQ(to_json(result.own->first), to_json(a.first));
  EXPECT_EQ(to_json(result.own->second), to_json(b.second));
  EXPECT_EQ(result.own->vehicles, result.parts.front().vehicles);
}

TEST(Comparison, TellsThatADetectorFindsFewOrNone) {
  const auto first = outcomes(40, 8);
  std::vector<HostOutcome> blind = first;
  for (HostOutcome& host : blind) host.clean_iou = host.attacked_iou = 0;
  const Comparison none = compare_outcomes(first, blind, kObjects, false);
  EXPECT_GT(none.found[0], 30);
  EXPECT_EQ(none.found[1], 0);
  EXPECT_TRUE(none.few());
  EXPECT_FALSE(compare_outcomes(first, first, kObjects, false).few());
  for (HostOutcome& host : blind)
    if (host.id.frame == "frame0") host.clean_iou = 0.9;
  const Comparison tenth = compare_outcomes(blind, blind, kObjects, false);  // 4 of 40 are enough
  EXPECT_EQ(tenth.found, (std::array<int, 2>{4, 4}));
  EXPECT_FALSE(tenth.few());
  for (HostOutcome& host : blind)
    if (host.id == HostId{"frame0", 0}) host.clean_iou = 0;
  EXPECT_TRUE(compare_outcomes(blind, first, kObjects, false).few());
}

// With few clusters, interval and p-value use Student's t with few degrees of freedom.
TEST(Comparison, APartsPIsOfItsOwnClusters) {
  std::vector<HostOutcome> first(40), second;
  for (int i = 0; i < 40; ++i) {
    HostOutcome& host = first[as_size(i)];
    host.id = {"f" + std::to_string(i), 0};
    host.range = i < 4 ? 5 : 40;
    host.clean_iou = host.attacked_iou = 0.9;
  }
  second = first;
  for (const int lost : {0, 1, 2, 10, 11, 20}) second[as_size(lost)].attacked_iou = 0;
  const Comparison result = compare_outcomes(first, second, {"a.glb"}, false);
  std::vector<double> own;
  int clusters = 0;
  for (const ComparedPart& part : result.parts) {
    if (part.by != "range") continue;
    clusters += part.clusters.count;
    EXPECT_EQ(part.clusters.count, part.vehicles) << part.name;
  }
  EXPECT_EQ(clusters, 40);
  for (std::size_t i = 1; i < result.parts.size(); ++i)
    own.push_back(p_value(result.parts[i].difference, result.parts[i].clusters.count));
  const std::vector<double> adjusted = holm(own);
  for (std::size_t i = 1; i < result.parts.size(); ++i)
    EXPECT_DOUBLE_EQ(result.parts[i].p, adjusted[i - 1]) << result.parts[i].name;
}

TEST(Comparison, HolmsProcedureIsTheTextbooks) {
  EXPECT_EQ(holm(std::vector<double>{0.01, 0.04, 0.03, 0.005}),
            (std::vector<double>{0.03, 0.06, 0.06, 0.02}));
  EXPECT_TRUE(holm({}).empty());
}

TEST(Comparison, RefusesWhatCannotBeCompared) {
  ComparisonRequest request;
  EXPECT_THAT(test::error_text<FieldError>([&] { compare(request); }), testing::HasSubstr("detectors"));
  request.detectors.resize(2);
  EXPECT_THAT(test::error_text<FieldError>([&] { compare(request); }), testing::HasSubstr("names no object"));
  request.adaptive = true;
  EXPECT_THAT(test::error_text<FieldError>([&] { compare(request); }), testing::HasSubstr("adaptive"));
}

}  // namespace
}  // namespace mirage
