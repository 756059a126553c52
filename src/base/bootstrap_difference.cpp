// Statistics of several shares over the same draws of clusters.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "base/bootstrap_draws.h"

namespace mirage {

Interval statistic_of_draws(std::size_t items,
                            const std::function<void(std::uint64_t replicate, std::span<int> drawn)>& draw,
                            const std::function<double(std::span<const int> drawn)>& statistic,
                            const BootstrapSettings& settings) {
  const double tail = (1 - settings.confidence) / 2, infinity = std::numeric_limits<double>::infinity();
  std::vector<int> drawn(items, 1);
  Interval result{statistic(drawn), -infinity, infinity};
  std::vector<double> values;
  values.reserve(static_cast<std::size_t>(settings.replicates));
  for (int r = 0; r < settings.replicates && items > 0; ++r) {
    draw(static_cast<std::uint64_t>(r), drawn);
    if (const double value = statistic(drawn); !std::isnan(value)) values.push_back(value);
  }
  if (values.empty() ||
      static_cast<double>(values.size()) < (1 - tail) * static_cast<double>(settings.replicates))
    return result;
  result.low = quantile(values, tail);
  result.high = quantile(std::move(values), 1 - tail);
  return result;
}

void draw_with_replacement(RandomStream& random, std::size_t draws, std::span<int> drawn) {
  std::fill(drawn.begin(), drawn.end(), 0);
  for (std::size_t i = 0; i < draws; ++i)
    ++drawn[static_cast<std::size_t>(random.below(static_cast<int>(drawn.size())))];
}

Interval bootstrap_statistic(std::size_t clusters,
                             const std::function<double(std::span<const int> drawn)>& statistic,
                             const BootstrapSettings& settings) {
  const auto draw = [&](std::uint64_t replicate, std::span<int> drawn) {
    RandomStream random(settings.seed, settings.purpose, replicate);
    draw_with_replacement(random, clusters, drawn);
  };
  return statistic_of_draws(clusters, draw, statistic, settings);
}

Interval with_unseen_spread(Interval difference, std::size_t clusters, double confidence) {
  if (!(difference.low < difference.high)) {
    const double tail = (1 - confidence) / 2;
    const double unseen = 1 - std::pow(tail, 1.0 / static_cast<double>(clusters));
    difference.low = difference.value - unseen;
    difference.high = difference.value + unseen;
  }
  difference.low = std::max(difference.low, -1.0);
  difference.high = std::min(difference.high, 1.0);
  return difference;
}

Interval bootstrap_difference(std::span<const PairedSums> clusters, const BootstrapSettings& settings) {
  std::vector<PairedSums> used;
  PairedSums all;
  for (const PairedSums& cluster : clusters) {
    if (!(cluster.a.denominator > 0) && !(cluster.b.denominator > 0)) continue;
    used.push_back(cluster);
    all.a.denominator += cluster.a.denominator;
    all.b.denominator += cluster.b.denominator;
  }
  if (!(all.a.denominator > 0) || !(all.b.denominator > 0)) return {0, -1, 1};
  const Interval result = bootstrap_statistic(
      used.size(),
      [&](std::span<const int> drawn) {
        PairedSums sums;
        for (std::size_t i = 0; i < used.size(); ++i) {
          sums.a.numerator += drawn[i] * used[i].a.numerator;
          sums.a.denominator += drawn[i] * used[i].a.denominator;
          sums.b.numerator += drawn[i] * used[i].b.numerator;
          sums.b.denominator += drawn[i] * used[i].b.denominator;
        }
        return sums.a.numerator / sums.a.denominator - sums.b.numerator / sums.b.denominator;
      },
      settings);
  return with_unseen_spread(result, used.size(), settings.confidence);
}

}  // namespace mirage
