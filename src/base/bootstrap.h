// Confidence intervals of shares whose observations come in clusters (vehicles of one frame are not
// independent): the percentile bootstrap over clusters (Efron and Tibshirani, An Introduction to the
// Bootstrap, 1993, sections 8 and 13.3).
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string_view>

namespace mirage {

/// What one cluster (a frame) adds to a ratio.
struct ClusterSums {
  double numerator = 0, denominator = 0;
};

struct Interval {
  double value = 0, low = 0, high = 0;
};

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
/// Where every cluster has the same ratio of 0 or of 1 the bootstrap sees no spread at all; the interval is
/// then the exact binomial one (Clopper and Pearson, Biometrika 1934) with the clusters as trials, which is
/// wide for few clusters. Without any denominator: value 0, interval [0, 1].
Interval bootstrap_interval(std::span<const ClusterSums> clusters, const BootstrapSettings& settings = {});

/// {value, low, high}
nlohmann::json to_json(const Interval& interval);

}  // namespace mirage
