#include "base/bootstrap.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "base/binomial.h"
#include "base/random.h"

namespace mirage {

double quantile(std::vector<double> values, double q) {
  const auto n = static_cast<double>(values.size());
  const double rank = std::clamp(std::ceil(q * n - 1e-9), 1.0, n);
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(rank) - 1;
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

std::vector<Interval> bootstrap_intervals(std::span<const double> denominators,
                                          std::span<const std::vector<double>> numerators,
                                          const BootstrapSettings& settings) {
  std::vector<std::size_t> used;  // a cluster with nothing to count is none
  double all = 0;
  for (std::size_t i = 0; i < denominators.size(); ++i)
    if (denominators[i] > 0) {
      used.push_back(i);
      all += denominators[i];
    }
  std::vector<Interval> result(numerators.size(), Interval{0, 0, 1});
  if (used.empty()) return result;
  const double tail = (1 - settings.confidence) / 2;
  const auto trials = static_cast<double>(used.size());
  std::vector<std::size_t> spread;  // the ratios that vary between clusters
  for (std::size_t k = 0; k < numerators.size(); ++k) {
    const std::vector<double>& counted = numerators[k];
    double sum = 0;
    bool same = true;
    for (const std::size_t i : used) {
      sum += counted[i];
      same = same && counted[i] * denominators[used[0]] == counted[used[0]] * denominators[i];
    }
    result[k].value = sum / all;
    if (same && sum >= 0 && sum <= all) {
      const BinomialInterval exact = binomial_interval(result[k].value * trials, trials, settings.confidence);
      result[k].low = exact.low;
      result[k].high = exact.high;
    } else {
      spread.push_back(k);
    }
  }
  if (spread.empty()) return result;
  std::vector<double> rows;  // a row a used cluster: its denominator, then its numerators
  for (const std::size_t i : used) {
    rows.push_back(denominators[i]);
    for (const std::size_t k : spread) rows.push_back(numerators[k][i]);
  }
  const std::size_t width = 1 + spread.size();
  std::vector<std::vector<double>> ratios(spread.size());
  std::vector<double> sums(width);
  for (int r = 0; r < settings.replicates; ++r) {
    RandomStream random(settings.seed, settings.purpose, static_cast<std::uint64_t>(r));
    std::fill(sums.begin(), sums.end(), 0.0);
    for (std::size_t i = 0; i < used.size(); ++i) {
      const double* row =
          rows.data() + width * static_cast<std::size_t>(random.below(static_cast<int>(used.size())));
      for (std::size_t c = 0; c < width; ++c) sums[c] += row[c];
    }
    for (std::size_t c = 0; c < spread.size(); ++c) ratios[c].push_back(sums[c + 1] / sums[0]);
  }
  for (std::size_t c = 0; c < spread.size(); ++c) {
    result[spread[c]].low = quantile(ratios[c], tail);
    result[spread[c]].high = quantile(ratios[c], 1 - tail);
  }
  return result;
}

Interval bootstrap_interval(std::span<const ClusterSums> clusters, const BootstrapSettings& settings) {
  std::vector<double> denominators, numerators;
  for (const ClusterSums& cluster : clusters) {
    denominators.push_back(cluster.denominator);
    numerators.push_back(cluster.numerator);
  }
  return bootstrap_intervals(denominators, {&numerators, 1}, settings).front();
}

nlohmann::json to_json(const Interval& interval) {
  return {{"value", interval.value}, {"low", interval.low}, {"high", interval.high}};
}

}  // namespace mirage
