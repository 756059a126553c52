#include "base/intervals.h"

#include <fmt/format.h>

#include <boost/math/distributions/binomial.hpp>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/error.h"

namespace mirage {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::infinity();
/// Weight of the assumed design effect against the clusters that hold a success, and the least one that is
/// believed: clusters that agree by chance say little.
constexpr double kAssumedClusters = 0.05, kMinDesignEffect = 0.1;

double t_quantile(double freedom) {
  return boost::math::quantile(boost::math::students_t(freedom), (1 + kConfidence) / 2);
}

double design_effect(double cluster_size) {
  return 1 + std::max(0.0, cluster_size - 1) * kWithinCluster;
}

void add(std::vector<double>& to, std::span<const double> more, double times = 1) {
  to.resize(std::max(to.size(), more.size()));
  for (std::size_t i = 0; i < more.size(); ++i) to[i] += times * more[i];
}

/// The jackknife with the groups of that name left out.
template <class NameOf, class Figure>
Estimate left_out(const SumsByCrossing& sums, const std::vector<double>& all, double value,
                  const NameOf& name_of, const Figure& figure) {
  std::map<std::decay_t<decltype(name_of(sums.begin()->first))>, std::vector<double>> groups;
  for (const auto& [name, of] : sums) add(groups[name_of(name)], of);
  std::vector<double> without;
  for (const auto& [name, of] : groups) {
    std::vector<double> others = all;
    add(others, of, -1);
    without.push_back(groups.size() > 1 ? figure(others) : std::nan(""));
  }
  return jackknife(value, without);
}

/// The longer half of an interval of this file, since ends are cut at 1. Infinite where nothing is known.
double standard_error(const Interval& interval, int clusters) {
  if (clusters < 2) return kUnknown;
  return std::max(interval.high - interval.value, interval.value - interval.low) / t_quantile(clusters - 1);
}

}  // namespace

Estimate jackknife(double value, std::span<const double> without) {
  Estimate estimate{value, 0, static_cast<double>(without.size()) - 1};
  for (const double other : without) estimate.variance += (other - value) * (other - value);
  estimate.variance *= estimate.freedom / (estimate.freedom + 1);
  if (without.size() < 2 || !std::isfinite(estimate.variance)) estimate.variance = kUnknown;
  return estimate;
}

Estimate jackknife(const SumsByCrossing& sums,
                   const std::function<double(std::span<const double> sums)>& figure) {
  std::vector<double> all;
  std::set<int> runs;
  for (const auto& [name, of] : sums) {
    add(all, of);
    runs.insert(name.second);
  }
  const double value = figure(all);
  const Estimate by_cluster = left_out(
      sums, all, value, [](const CrossingName& name) { return name.first; }, figure);
  if (runs.size() < 2) return by_cluster;
  const Estimate by_run = left_out(
      sums, all, value, [](const CrossingName& name) { return name.second; }, figure);
  const Estimate by_crossing = left_out(
      sums, all, value, [](const CrossingName& name) { return name; }, figure);
  const double a = by_cluster.variance, b = by_run.variance;
  Estimate both{value, std::max({a, b, a + b - by_crossing.variance}), by_cluster.freedom};
  if (std::isfinite(a + b) && a + b > 0)
    both.freedom = (a + b) * (a + b) / (a * a / by_cluster.freedom + b * b / by_run.freedom);
  if (!std::isfinite(a + b)) both.variance = kUnknown;
  return both;
}

double Trials::independent() const {
  return count / design_effect(cluster_size);
}

Trials trials_of(std::span<const double> of_cluster) {
  Trials trials;
  for (const double count : of_cluster) {
    if (!(count > 0)) continue;
    trials.count += count;
    trials.cluster_size += count * count;
    ++trials.clusters;
  }
  if (trials.count > 0) trials.cluster_size /= trials.count;
  return trials;
}

Interval share_interval(const Estimate& share, const Trials& trials) {
  if (!(trials.count > 0)) return {0, 0, 1};
  const double p = std::clamp(share.value, 0.0, 1.0);
  if (trials.clusters < 2 || !std::isfinite(share.variance)) return {p, 0, 1};
  const double alone = p * (1 - p) / trials.count, assumed = design_effect(trials.cluster_size);
  // Clusters that hold the rarer outcome.
  const double informed = std::min(trials.clusters, std::min(p, 1 - p) * trials.count);
  double deff = assumed;
  if (alone > 0)
    deff = std::max(kMinDesignEffect, (informed * share.variance / alone + kAssumedClusters * assumed) /
                                          (informed + kAssumedClusters));
  const double n = trials.count / deff, t = t_quantile(share.freedom), tt = t * t / n;
  const double middle = (p + tt / 2) / (1 + tt),
               reach = t / (1 + tt) * std::sqrt(p * (1 - p) / n + tt / (4 * n));
  // Wilson's ends at none and all are 0 and 1, but for rounding.
  return {p, p > 0 ? std::max(0.0, middle - reach) : 0, p < 1 ? std::min(1.0, middle + reach) : 1};
}

Interval plain_interval(const Estimate& figure, double least) {
  if (!std::isfinite(figure.variance) || !(figure.freedom > 0)) return {figure.value, -kUnknown, kUnknown};
  const double reach = t_quantile(figure.freedom) * std::sqrt(figure.variance + least * least);
  return {figure.value, figure.value - reach, figure.value + reach};
}

Interval difference_interval(const Estimate& difference, const Trials& trials) {
  if (!(trials.count > 0)) return {0, -1, 1};
  const Interval wide = plain_interval(difference, 1 / trials.independent());
  return {wide.value, std::max(-1.0, wide.low), std::min(1.0, wide.high)};
}

void ClusteredShare::add(const std::string& cluster, double value, int run, double weight) {
  std::vector<double>& sums = sums_[{cluster, run}];
  sums.resize(2);
  sums[0] += weight * value;
  sums[1] += weight;
}

Trials ClusteredShare::trials() const {
  std::map<std::string, double> clusters;
  std::set<int> runs;
  for (const auto& [name, of] : sums_) {
    clusters[name.first] += of[1];
    runs.insert(name.second);
  }
  std::vector<double> counts;  // more runs show no more vehicles
  for (const auto& [name, count] : clusters) counts.push_back(count / static_cast<double>(runs.size()));
  return trials_of(counts);
}

static double ratio(std::span<const double> sums) {
  return sums[1] > 1e-9 ? sums[0] / sums[1] : std::nan("");
}

Interval ClusteredShare::interval() const {
  return sums_.empty() ? Interval{0, 0, 1} : share_interval(jackknife(sums_, ratio), trials());
}

Interval ClusteredShare::mean_interval() const {
  return sums_.empty() ? Interval{0, -kUnknown, kUnknown} : plain_interval(jackknife(sums_, ratio));
}

Estimate combined_estimate(std::span<const ClusteredShare> shares, std::span<const double> factors) {
  SumsByCrossing all;
  for (std::size_t k = 0; k < shares.size(); ++k) {
    if (shares[k].sums().empty()) return {};
    for (const auto& [name, of] : shares[k].sums()) {
      std::vector<double>& sums = all[name];
      sums.resize(2 * shares.size());
      std::copy(of.begin(), of.end(), sums.begin() + static_cast<std::ptrdiff_t>(2 * k));
    }
  }
  return jackknife(all, [&](std::span<const double> sums) {
    double value = 0;
    for (std::size_t k = 0; k < shares.size(); ++k) value += factors[k] * ratio(sums.subspan(2 * k, 2));
    return value;
  });
}

Interval combined_shares(std::span<const ClusteredShare> shares, std::span<const double> factors) {
  double least = 0;  // one trial more of each share, in the mean of square
  for (std::size_t k = 0; k < shares.size(); ++k) {
    if (shares[k].sums().empty()) return {0, -kUnknown, kUnknown};
    const double one = factors[k] / shares[k].trials().independent();
    least += one * one / 2;
  }
  return plain_interval(combined_estimate(shares, factors), std::sqrt(least));
}

Interval share_difference(const ClusteredShare& a, const ClusteredShare& b) {
  if (a.sums().empty() || b.sums().empty()) return {0, -1, 1};
  const Interval wide = combined_shares(std::array{a, b}, std::array{1.0, -1.0});
  return {wide.value, std::max(-1.0, wide.low), std::min(1.0, wide.high)};
}

double p_value(const Interval& difference, int clusters) {
  const double error = standard_error(difference, clusters);
  if (!std::isfinite(error) || error <= 0) return 1;
  const boost::math::students_t t(clusters - 1);
  return 2 * boost::math::cdf(boost::math::complement(t, std::abs(difference.value) / error));
}

double detectable_difference(const Interval& difference, int clusters) {
  const double error = standard_error(difference, clusters);
  if (!std::isfinite(error)) return 1;
  constexpr double kPower = 0.8;
  return std::min(1.0, error * (t_quantile(clusters - 1) +
                                boost::math::quantile(boost::math::students_t(clusters - 1), kPower)));
}

std::vector<double> holm(std::span<const double> p) {
  std::vector<std::size_t> order(p.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return p[a] < p[b]; });
  std::vector<double> adjusted(p.size());
  double largest = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    largest = std::max(largest, std::min(1.0, static_cast<double>(p.size() - k) * p[order[k]]));
    adjusted[order[k]] = largest;
  }
  return adjusted;
}

Interval median_interval(std::vector<double> values) {
  if (values.empty()) throw InputError("median", "values", "there are none", "give at least one");
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  const boost::math::binomial ranks(static_cast<double>(n), 0.5);
  std::size_t outside = 0;  // values on each side that the interval may leave out, and one
  while (2 * boost::math::cdf(ranks, static_cast<double>(outside)) <= 1 - kConfidence) ++outside;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  return {(values[(n - 1) / 2] + values[n / 2]) / 2, outside > 0 ? values[outside - 1] : -kInfinity,
          outside > 0 ? values[n - outside] : kInfinity};
}

double quantile(std::vector<double> values, double q) {
  const auto n = static_cast<double>(values.size());
  const double rank = std::clamp(std::ceil(q * n - 1e-9), 1.0, n);
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(rank) - 1;
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

DifferenceVerdict classify(const Interval& difference) {
  if (difference.low > 0) return DifferenceVerdict::more;
  if (difference.high < 0) return DifferenceVerdict::less;
  return difference.low >= -kSameWithin && difference.high <= kSameWithin ? DifferenceVerdict::same
                                                                          : DifferenceVerdict::open;
}

nlohmann::json to_json(const Interval& interval) {
  return {{"value", interval.value}, {"low", interval.low}, {"high", interval.high}};
}

std::string signed_points(double difference) {
  const std::string text = fmt::format("{:+.1f}", 100 * difference);
  return text.ends_with("0.0") && text.size() == 4 ? "0.0" : text;
}

std::string signed_points(const Interval& difference) {
  return fmt::format("{} ({} to {})", signed_points(difference.value), signed_points(difference.low),
                     signed_points(difference.high));
}

std::string cluster_of(const std::string& frame, int track) {
  return track < 0 ? frame : "vehicle " + std::to_string(track);
}

void Clusters::add(const std::string& frame, int track) {
  by_vehicle_ = by_vehicle_ || track >= 0;
  names_.insert(cluster_of(frame, track));
}

ClusterCount Clusters::count() const {
  return {by_vehicle_ ? "vehicle" : "frame", static_cast<int>(names_.size())};
}

std::string to_string(const ClusterCount& clusters) {
  const std::string count =
      fmt::format("{} {}{}", clusters.count, clusters.by, clusters.count == 1 ? "" : "s");
  return clusters.count < kFewClusters ? count + " only: intervals are wide and approximate" : count;
}

nlohmann::json to_json(const ClusterCount& clusters) {
  return {{"by", clusters.by}, {"count", clusters.count}};
}

ClusterCount cluster_count_from_json(const JsonFields& fields) {
  return {fields.text("by"), fields.count("count")};
}

}  // namespace mirage
