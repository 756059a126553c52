// The assignment against all permutations.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <random>

#include "base/error.h"
#include "base/sizes.h"
#include "tracking/tracker.h"

namespace mirage {
namespace {

/// The least cost over all ways to give every row its own column (rows ≤ columns).
double least_cost(const Eigen::MatrixXd& cost) {
  std::vector<int> columns(as_size(cost.cols()));
  std::iota(columns.begin(), columns.end(), 0);
  double least = std::numeric_limits<double>::infinity();
  do {
    double sum = 0;
    for (int r = 0; r < cost.rows(); ++r) sum += cost(r, columns[as_size(r)]);
    least = std::min(least, sum);
  } while (std::next_permutation(columns.begin(), columns.end()));
  return least;
}

double total(const Eigen::MatrixXd& cost, const std::vector<std::pair<int, int>>& pairs) {
  double sum = 0;
  for (const auto& [r, c] : pairs) sum += cost(r, c);
  return sum;
}

TEST(Assignment, IsTheCheapestOfAllPermutations) {
  std::mt19937 random(3);
  std::normal_distribution<double> draw;
  for (int i = 0; i < 200; ++i) {
    const int rows = 1 + i % 5, columns = rows + i % 3;
    const Eigen::MatrixXd cost =
        Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return 10 * draw(random); });
    const auto pairs = assign(cost);
    ASSERT_EQ(static_cast<int>(pairs.size()), rows);
    EXPECT_NEAR(total(cost, pairs), least_cost(cost), 1e-9);
    auto mirrored = assign(cost.transpose());
    EXPECT_NEAR(total(cost.transpose(), mirrored), least_cost(cost), 1e-9);
  }
}

TEST(Assignment, MakesAsManyPairsAsAreAllowed) {
  Eigen::MatrixXd cost(2, 2);
  cost << 0, 1, 1, 5;
  // Taking the cheapest pair first would leave a row without a column.
  EXPECT_EQ(assign(cost, 2), (std::vector<std::pair<int, int>>{{0, 1}, {1, 0}}));
  EXPECT_EQ(assign(cost, 0.5), (std::vector<std::pair<int, int>>{{0, 0}}));
  EXPECT_TRUE(assign(cost, -1).empty());
  cost(1, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(assign(cost, 2), (std::vector<std::pair<int, int>>{{0, 0}}));
}

TEST(Assignment, OfNothingIsEmpty) {
  EXPECT_TRUE(assign(Eigen::MatrixXd(0, 3)).empty());
  EXPECT_TRUE(assign(Eigen::MatrixXd(3, 0)).empty());
}

}  // namespace

// The tracker on hand-made sequences, and its filter against the published values.

namespace {

TrackedDetection car(double x, double y = 0, double yaw = 0) {
  return {{{x, y, 4, 1.7, yaw}, -1.7, 1.5}, 0.9};
}

const TrackState& only(const std::vector<TrackState>& states) {
  if (states.size() != 1) throw std::runtime_error("not one track");
  return states.front();
}

TEST(Tracker, ConfirmsAtTheThirdDetectionCoastsAndEndsAtTheSecondMiss) {
  Tracker tracker;
  for (int i = 0; i < 5; ++i) {
    const std::vector<TrackedDetection> seen = {car(10 + 0.5 * i)};
    const auto states = tracker.step(0.1 * i, seen);
    EXPECT_EQ(only(states).id, 1);
    EXPECT_EQ(only(states).hits, i + 1);
    EXPECT_EQ(only(states).confirmed, i >= 2);
    EXPECT_EQ(only(states).detection, 0);
  }
  const auto coasting = tracker.step(0.5, {});
  EXPECT_EQ(only(coasting).detection, -1);
  EXPECT_EQ(only(coasting).misses, 1);
  EXPECT_TRUE(only(coasting).confirmed);
  EXPECT_NEAR(only(coasting).box.bev.x, 12.5, 0.02);  // it drives on
  EXPECT_NEAR(only(coasting).velocity.x(), 5, 0.1);
  EXPECT_TRUE(tracker.step(0.6, {}).empty());
}

TEST(Tracker, KeepsAnIdentityOverAGapThatIsShorterThanDeath) {
  TrackerSettings settings;
  settings.death = 4;
  Tracker tracker(settings);
  for (int i = 0; i < 12; ++i) {
    std::vector<TrackedDetection> seen;
    if (i < 5 || i > 7) seen.push_back(car(10 + 0.8 * i));
    EXPECT_EQ(only(tracker.step(0.1 * i, seen)).id, 1) << i;
  }
  Tracker short_lived;  // two misses end it
  int last = 0;
  for (int i = 0; i < 12; ++i) {
    std::vector<TrackedDetection> seen;
    if (i < 5 || i > 7) seen.push_back(car(10 + 0.8 * i));
    for (const TrackState& state : short_lived.step(0.1 * i, seen)) last = state.id;
  }
  EXPECT_EQ(last, 2);
}

TEST(Tracker, TwoThatMeetKeepTheirOwnTracks) {
  TrackerSettings settings;
  settings.matching = TrackMatching::distance;
  Tracker tracker(settings);
  std::vector<TrackState> states;
  for (int i = 0; i < 40; ++i) {
    const double s = 0.6 * i;
    // The detections alternate: their order in the list carries no information.
    std::vector<TrackedDetection> seen = {car(s, 1.8), car(24 - s, -1.8, std::numbers::pi)};
    if (i % 2 == 1) std::swap(seen[0], seen[1]);
    states = tracker.step(0.1 * i, seen);
    ASSERT_EQ(states.size(), 2u) << i;
  }
  EXPECT_NEAR(states[0].velocity.x(), 6, 0.1);
  EXPECT_NEAR(states[0].box.bev.y, 1.8, 0.1);
  EXPECT_NEAR(states[1].velocity.x(), -6, 0.1);
}

TEST(Tracker, AHeadingThatFlipsTurnsNoBox) {
  Tracker tracker;
  for (int i = 0; i < 8; ++i) {
    const std::vector<TrackedDetection> seen = {car(10, 0, i % 2 ? 0.3 : 0.3 - std::numbers::pi)};
    const auto states = tracker.step(0.1 * i, seen);
    EXPECT_NEAR(std::abs(std::cos(only(states).box.bev.yaw - 0.3)), 1, 1e-9);
  }
}

// With P₀ = diag(10₇, 10⁴₃), Q = diag(1₇, 0.01₃) and R = I the second detection moves x by
// (10 + 10⁴ dt² + 1) / (10 + 10⁴ dt² + 2) of its innovation and v by 10⁴ dt / (…), dt in frames of 0.1 s.
TEST(Tracker, UpdatesByThePublishedNumbers) {
  for (const double frames : {1.0, 2.0}) {
    Tracker tracker;
    const std::vector<TrackedDetection> first = {car(10)}, second = {car(10.5)};
    tracker.step(0, first);
    const TrackState state = only(tracker.step(0.1 * frames, second));
    const double p = 10 + 1e4 * frames * frames + 1, cross = 1e4 * frames;
    EXPECT_NEAR(state.box.bev.x, 10 + 0.5 * p / (p + 1), 1e-9);
    EXPECT_NEAR(state.velocity.x(), 10 * 0.5 * cross / (p + 1), 1e-9);
    EXPECT_NEAR(state.box.bev.length, 4, 1e-12);
  }
}

TEST(Tracker, WhatIsTooFarBeginsATrack) {
  TrackerSettings settings;
  settings.matching = TrackMatching::distance;
  settings.farthest = 2;
  for (const double step : {1.9, 2.1}) {
    Tracker tracker(settings);
    const std::vector<TrackedDetection> first = {car(10)}, second = {car(10 + step)};
    tracker.step(0, first);
    EXPECT_EQ(tracker.step(0.1, second).size(), step < 2 ? 1u : 2u);
  }
}

TEST(Tracker, RefusesATimeThatDoesNotRise) {
  Tracker tracker;
  tracker.step(1, {});
  EXPECT_THROW(tracker.step(1, {}), InputError);
}

}  // namespace
}  // namespace mirage
