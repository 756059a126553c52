// When a claim about a difference holds: one rule, its family, and what it would take to tell.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "validation/paper/verdicts.h"

namespace mirage::paper {
namespace {

constexpr Verdict kHolds = Verdict::holds, kFails = Verdict::fails, kOpen = Verdict::open;
constexpr double kInf = std::numeric_limits<double>::infinity();

struct IntervalCase {
  Interval d;
  Verdict more, no_less, no_help;
};

// The margin is 5 points.
const IntervalCase kCases[] = {
    {{0.10, 0.02, 0.20}, kHolds, kHolds, kOpen},       // more; whether by 5 points is open
    {{0.10, 0.06, 0.20}, kHolds, kHolds, kFails},      // more, by more than the margin
    {{0.025, 0.01, 0.04}, kHolds, kHolds, kHolds},     // more, and of no help: both are true
    {{0.00, -0.04, 0.04}, kOpen, kHolds, kHolds},      // within the margin on both sides
    {{-0.025, -0.04, -0.01}, kFails, kHolds, kHolds},  // less, by less than the margin
    {{-0.04, -0.08, -0.01}, kFails, kOpen, kHolds},    // less; whether by the margin is open
    {{-0.10, -0.20, -0.06}, kFails, kFails, kHolds},  {{0.00, -0.06, 0.06}, kOpen, kOpen, kOpen},
    {{0.10, -0.02, 0.20}, kOpen, kHolds, kOpen},      {{-0.10, -0.20, 0.02}, kOpen, kOpen, kHolds},
    {{0.00, 0.00, 0.10}, kOpen, kHolds, kOpen},  // an end on the bound tells nothing
    {{-0.02, -0.05, 0.00}, kOpen, kOpen, kHolds},     {{0.05, 0.05, 0.05}, kHolds, kHolds, kOpen},
    {{0.10, -kInf, kInf}, kOpen, kOpen, kOpen},
};

TEST(Verdicts, OneTableOfIntervals) {
  for (const IntervalCase& one : kCases) {
    const std::string text = testing::PrintToString(one.d.low) + " to " + testing::PrintToString(one.d.high);
    EXPECT_EQ(judge(Claim::more, one.d), one.more) << text;
    EXPECT_EQ(judge(Claim::no_less, one.d), one.no_less) << text;
    EXPECT_EQ(judge(Claim::no_help, one.d), one.no_help) << text;
  }
}

TEST(Verdicts, ClaimsAboutOneDifferenceAgree) {
  int seen = 0;
  for (int low = -12; low <= 12; ++low)
    for (int high = low; high <= 12; ++high) {
      const Interval d{0.005 * (low + high), 0.01 * low, 0.01 * high};
      const Interval back{-d.value, -d.high, -d.low};
      if (is_more(d) == kHolds) {
        EXPECT_EQ(is_no_less(d), kHolds);
      }
      if (is_no_less(d) == kFails) {
        EXPECT_EQ(is_more(d), kFails);
      }
      EXPECT_EQ(is_no_help(d), is_no_less(back));  // what takes nothing off is, turned round, no less
      EXPECT_FALSE(is_more(d) == kHolds && is_more(back) == kHolds);
      EXPECT_FALSE(is_no_help(d) == kFails && is_more(d) != kHolds);  // it helps, so it is more
      // The p-value tells where the verdict does.
      for (const Claim claim : {Claim::more, Claim::no_less, Claim::no_help})
        if (low < high) {
          EXPECT_EQ(p_value(claim, d) < 0.05, judge(claim, d) != kOpen) << low << " " << high;
        }
      ++seen;
    }
  EXPECT_EQ(seen, 25 * 26 / 2);
}

TEST(Verdicts, SeveralTogether) {
  EXPECT_EQ(all_of({kHolds, kOpen}), kOpen);
  EXPECT_EQ(all_of({kHolds, kOpen, kFails}), kFails);
  EXPECT_EQ(all_of({kHolds, kHolds}), kHolds);
  EXPECT_EQ(all_of({}), kOpen);
}

TEST(Verdicts, PValuesAreThoseOfANormalDifference) {
  // Standard error 0.01: the interval is ± 1.96 of it.
  const auto at = [](double z) { return Interval{0.01 * z, 0.01 * (z - 1.959964), 0.01 * (z + 1.959964)}; };
  EXPECT_NEAR(p_value(Claim::more, at(1.959964)), 0.05, 1e-6);
  EXPECT_NEAR(p_value(Claim::more, at(-2.575829)), 0.01, 1e-6);
  EXPECT_NEAR(p_value(Claim::no_less, at(-5 + 3.290527)), 0.001, 1e-6);  // the bound is 5 of them below 0
  EXPECT_EQ(p_value(Claim::more, at(0)), 1);
  EXPECT_EQ(p_value(Claim::more, {0.1, -kInf, kInf}), 1);
  EXPECT_EQ(p_value(Claim::more, {0.1, 0.1, 0.1}), 0);
}

TEST(Verdicts, HolmsCorrectionOpensWhatIsTooWeakForTheFamily) {
  const auto with_p = [](double z) { return comparison("", {z, z - 1.959964, z + 1.959964}); };
  // p = 0.0027, 0.0124, 0.0193, 0.5: against 0.05 / 4, / 3, / 2, / 1.
  std::vector<Comparison> four = {with_p(2.34), with_p(3.0), with_p(-0.674), with_p(-2.5)};
  std::vector<Comparison*> family;
  for (Comparison& one : four) family.push_back(&one);
  correct(family);
  EXPECT_EQ(four[1].verdict, kHolds);
  EXPECT_EQ(four[3].verdict, kFails);
  EXPECT_EQ(four[0].verdict, kHolds);
  EXPECT_EQ(four[2].verdict, kOpen);
  EXPECT_NEAR(four[1].p_family, 4 * four[1].p, 1e-12);
  EXPECT_NEAR(four[3].p_family, 3 * four[3].p, 1e-12);
  EXPECT_NEAR(four[0].p_family, 2 * four[0].p, 1e-12);
  EXPECT_EQ(four[1].rank, 0);
  EXPECT_EQ(four[0].family, 4);
  // The same question among thirty that tell nothing is left open; and so is all that is weaker.
  std::vector<Comparison> many(30, with_p(0.3));
  many.push_back(with_p(2.6));
  many.push_back(with_p(4.5));
  family.clear();
  for (Comparison& one : many) family.push_back(&one);
  correct(family);
  EXPECT_EQ(many[30].verdict, kOpen);
  EXPECT_EQ(judge(Claim::more, many[30].difference), kHolds);
  EXPECT_EQ(many[31].verdict, kHolds);
  for (const Comparison& one : many) EXPECT_LE(one.p_family, 1);
}

TEST(Verdicts, HowManyVehiclesItWouldTake) {
  // 100 vehicles, standard error 0.02, difference 0.02: told with 80 % at (1.96 + 0.8416)² times as many.
  const Comparison one = comparison("", {0.02, 0.02 - 0.0391993, 0.02 + 0.0391993});
  EXPECT_EQ(one.verdict, kOpen);
  EXPECT_EQ(vehicles_needed(one, 100), 790);  // 784.9, rounded up
  Comparison ranked = one;
  ranked.family = 10;  // against 0.005: (2.807 + 0.8416)²
  EXPECT_EQ(vehicles_needed(ranked, 100), 1400);
  // The margin counts: a difference of −3 points is 2 points above its bound.
  EXPECT_EQ(vehicles_needed(comparison("", {-0.03, -0.0691993, 0.0091993}, Claim::no_less), 100), 790);
  EXPECT_FALSE(vehicles_needed(comparison("", {0, -0.04, 0.04}), 100));
  EXPECT_FALSE(vehicles_needed(comparison("", {1e-6, -0.04, 0.04}), 100));
  EXPECT_FALSE(vehicles_needed(comparison("", {0.1, -kInf, kInf}), 100));
}

}  // namespace
}  // namespace mirage::paper
