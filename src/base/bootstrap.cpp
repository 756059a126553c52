#include "base/bootstrap.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/random.h"

namespace mirage {
namespace {

/// The ⌈q·n⌉-th smallest value.
double quantile(std::vector<double>& values, double q) {
  const auto n = static_cast<double>(values.size());
  const double rank = std::clamp(std::ceil(q * n - 1e-9), 1.0, n);
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(rank) - 1;
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

}  // namespace

Interval bootstrap_interval(std::span<const ClusterSums> clusters, const BootstrapSettings& settings) {
  std::vector<ClusterSums> used;  // a cluster with nothing to count is none
  ClusterSums all;
  bool never = true, always = true;
  for (const ClusterSums& cluster : clusters) {
    if (!(cluster.denominator > 0)) continue;
    used.push_back(cluster);
    all.numerator += cluster.numerator;
    all.denominator += cluster.denominator;
    never = never && cluster.numerator == 0;
    always = always && cluster.numerator == cluster.denominator;
  }
  if (used.empty()) return {0, 0, 1};
  const double tail = (1 - settings.confidence) / 2;
  Interval result;
  result.value = all.numerator / all.denominator;
  if (never || always) {
    const double unseen = 1 - std::pow(tail, 1.0 / static_cast<double>(used.size()));
    result.low = never ? 0 : 1 - unseen;
    result.high = never ? unseen : 1;
    return result;
  }
  std::vector<double> ratios;
  ratios.reserve(static_cast<std::size_t>(settings.replicates));
  for (int r = 0; r < settings.replicates; ++r) {
    RandomStream random(settings.seed, settings.purpose, static_cast<std::uint64_t>(r));
    ClusterSums sums;
    for (std::size_t i = 0; i < used.size(); ++i) {
      const ClusterSums& drawn = used[static_cast<std::size_t>(random.below(static_cast<int>(used.size())))];
      sums.numerator += drawn.numerator;
      sums.denominator += drawn.denominator;
    }
    ratios.push_back(sums.numerator / sums.denominator);
  }
  result.low = quantile(ratios, tail);
  result.high = quantile(ratios, 1 - tail);
  return result;
}

nlohmann::json to_json(const Interval& interval) {
  return {{"value", interval.value}, {"low", interval.low}, {"high", interval.high}};
}

}  // namespace mirage
