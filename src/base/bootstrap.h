// Confidence intervals of shares whose observations come in clusters (vehicles of one frame are not
// independent): the percentile bootstrap over clusters (Efron and Tibshirani, An Introduction to the
// Bootstrap, 1993, sections 8 and 13.3).
#pragma once

#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <span>
#include <string_view>
#include <vector>

namespace mirage {

/// What one cluster (a frame) adds to a ratio.
struct ClusterSums {
  double numerator = 0, denominator = 0;
};

/// A figure with its confidence bounds.
struct Interval {
  double value = 0, low = 0, high = 0;
};

/// How the draws are made.
struct BootstrapSettings {
  double confidence = 0.95;
  int replicates = 10'000;
  std::uint64_t seed = 0;
  std::string_view purpose = "bootstrap";  ///< of the random streams; replicate r draws from stream r
};

/// Σ numerators / Σ denominators, with the interval between the (1 ∓ confidence)/2 quantiles of that ratio
/// over `replicates` draws of as many clusters with replacement. Quantiles are order statistics: the ⌈q·R⌉-th
/// of R values. Clusters whose denominator is not positive are left out.
///
/// Where every cluster has the same ratio (none or all, or a single cluster) the bootstrap sees no spread at
/// all; the interval is then the exact binomial one (base/binomial.h) with the clusters as trials, which is
/// wide for few clusters. Without any denominator: value 0, interval [0, 1].
Interval bootstrap_interval(std::span<const ClusterSums> clusters, const BootstrapSettings& settings = {});

/// The same for several ratios with one denominator a cluster: numerators[k][i] is cluster i's of ratio k.
/// Each is what bootstrap_interval gives for it alone; the draws are made once.
std::vector<Interval> bootstrap_intervals(std::span<const double> denominators,
                                          std::span<const std::vector<double>> numerators,
                                          const BootstrapSettings& settings = {});

/// The ⌈q·n⌉-th smallest of n > 0 values (q ≤ 0: the smallest; q ≥ 1: the largest).
double quantile(std::vector<double> values, double q);

/// Any statistic of clusters, for comparisons of shares that were measured on the same clusters (paired):
/// `statistic` gets how often each of the `clusters` is drawn (all 1: the value itself) and may answer NaN
/// where it is not defined. The interval is the percentile one over the draws where it is; if it is undefined
/// in more draws than an interval's tail holds, it reaches to infinity on both sides.
Interval bootstrap_statistic(std::size_t clusters,
                             const std::function<double(std::span<const int> drawn)>& statistic,
                             const BootstrapSettings& settings = {});

/// What one cluster adds to two ratios that are compared.
struct PairedSums {
  ClusterSums a, b;
};

/// For a difference of shares: where every draw gives the same, the bootstrap sees no spread. What differs
/// may have been missed in as many clusters as there are, so such an interval reaches as far to either side
/// as that of a share that was never seen (bootstrap_interval). Others stay; all are cut at -1 and 1.
Interval with_unseen_spread(Interval difference, std::size_t clusters,
                            double confidence = BootstrapSettings().confidence);

/// Σa / Σa − Σb / Σb with its interval (bootstrap_statistic, with_unseen_spread). Value 0, interval [-1, 1],
/// if either ratio has nothing to count.
Interval bootstrap_difference(std::span<const PairedSums> clusters, const BootstrapSettings& settings = {});

/// {value, low, high}
nlohmann::json to_json(const Interval& interval);

}  // namespace mirage
