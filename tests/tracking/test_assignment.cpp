// The assignment against all permutations.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "tracking/assignment.h"

namespace mirage {
namespace {

/// The least cost over all ways to give every row a column of its own (rows ≤ columns).
double least_cost(const Eigen::MatrixXd& cost) {
  std::vector<int> columns(static_cast<std::size_t>(cost.cols()));
  std::iota(columns.begin(), columns.end(), 0);
  double least = std::numeric_limits<double>::infinity();
  do {
    double sum = 0;
    for (int r = 0; r < cost.rows(); ++r) sum += cost(r, columns[static_cast<std::size_t>(r)]);
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
  // The cheapest pair alone would leave a row without one.
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
}  // namespace mirage
