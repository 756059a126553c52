// 95 % intervals of figures over clusters: vehicles of one frame are not independent, and
// frames are few. One method for all of them:
//
// Spread. The delete-one-cluster jackknife: each cluster is left out in turn (Efron and Tibshirani, An
// Introduction to the Bootstrap, 1993, chapter 11). Its square is Σ (without_i − value)² · (k − 1)/k over k
// clusters, and Student's t has k − 1 degrees of freedom. Where clusters are crossed with runs (attacks from
// several seeds) both are left out in turn and the variances are added, less that of single crossings
// (Cameron, Gelbach and Miller, Journal of Business & Economic Statistics 29, 2011); t has Satterthwaite's
// degrees.
//
// Shares. Wilson's interval with Student's t and as many trials as the spread says they are worth (Korn and
// Graubard, Survey Methodology 24, 1998; Dean and Pagano, Journal of Survey Statistics and Methodology 3,
// 2015): n / deff with deff = variance / (p (1 − p) / n). If no trial or every trial counts, no spread shows;
// deff is then 1 + (m − 1) kWithinCluster for clusters of m trials, and that counts a little wherever
// successes are few.
//
// Differences. value ± t · √(variance + 1/n²), cut at ±1; n: trials over 1 + (m − 1) kWithinCluster, so one
// flip more than was seen is allowed for (Agresti and Min, Statistics in Medicine 24, 2005).
//
// Coverage, simulated (tests/base/test_intervals.cpp): share p uniform in 0.02 to 0.5, clusters of 1 to 10,
// mean over p; 5, 7, 20 or 100 clusters, within-cluster correlation 0 or 0.3: 94 to 97 % for shares; for
// differences 94 to 97 % from 20 clusters on, and more below. Coverage is lower where one cluster holds most
// trials.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/fields.h"
#include "base/json_fields.h"
#include "base/sizes.h"

namespace mirage {

/// Share of intervals that shall hold the true figure.
inline constexpr double kConfidence = 0.95;
/// Shares that differ by less count as the same.
inline constexpr double kSameWithin = 0.05;
/// With fewer clusters an interval is wide and rests on assumptions; tables say so.
inline constexpr int kFewClusters = 20;
/// Assumed correlation of two trials of one cluster, where the data cannot tell.
inline constexpr double kWithinCluster = 0.05;

/// A figure with its bounds.
struct Interval {
  double value = 0, low = 0, high = 0;
};
template <class Visitor, FieldsOf<Interval> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "value", s.value, "low", s.low, "high", s.high);
}
/// Verdict on a difference of shares. more, less: its interval excludes 0; same: it lies within ±kSameWithin;
/// open: neither.
enum class DifferenceVerdict { more, less, same, open };
constexpr auto words_of(DifferenceVerdict) {
  return std::to_array<const char*>({"more", "less", "the same within 5 points", "cannot be told"});
}
/// DifferenceVerdict's rule; an interval that ends at 0 is neither more nor less.
DifferenceVerdict classify(const Interval& difference);
/// {value, low, high}
nlohmann::json to_json(const Interval& interval);
/// A difference of shares in points with sign and one decimal: "+9.2", "-0.3"; "0.0" if it rounds to zero.
std::string signed_points(double difference);
/// The same with its interval: "+9.2 (+3.4 to +16.2)"
std::string signed_points(const Interval& difference);

/// A cluster by name, and the run (from another seed) by number.
using CrossingName = std::pair<std::string, int>;
/// Lists of sums, all of one length, by crossing; a figure over all is computed from them.
using SumsByCrossing = std::map<CrossingName, std::vector<double>>;

/// A figure over clusters with its jackknife variance.
struct Estimate {
  double value = 0;
  double variance = 0;  ///< infinite where a cluster left out leaves no figure, or there is one cluster
  double freedom = 0;   ///< degrees, for Student's t
};
/// `without`: the figure with each cluster left out in turn.
Estimate jackknife(double value, std::span<const double> without);
/// `figure` of the sums over all crossings; it may answer NaN where it is not defined.
Estimate jackknife(const SumsByCrossing& sums,
                   const std::function<double(std::span<const double> sums)>& figure);

/// The trials behind a share; those of one run if there are several.
struct Trials {
  double count = 0;
  double cluster_size = 0;  ///< mean over the trials of their cluster's size
  double clusters = 0;
  /// Effective number of trials where the data cannot tell.
  double independent() const;
};
/// From the number of trials in each cluster.
Trials trials_of(std::span<const double> of_cluster);

/// Interval of a share, in [0, 1]. Without trials: 0 in [0, 1].
Interval share_interval(const Estimate& share, const Trials& trials);
/// Interval of a difference of shares, in [-1, 1]: plain_interval with `least` = 1 / trials.independent().
Interval difference_interval(const Estimate& difference, const Trials& trials);
/// value ± t · √(variance + least²); `least`: the change by one more outcome. Infinite if the variance is.
Interval plain_interval(const Estimate& figure, double least = 0);

/// Share of trials that come in clusters, or their mean.
class ClusteredShare {
 public:
  /// A trial: 1 or true if it has the property in question, 0 if not, or any number whose mean is wanted.
  /// `weight`: 1 / n if the same vehicle comes n times, with other meshes.
  void add(const std::string& cluster, double value, int run = 0, double weight = 1);
  const SumsByCrossing& sums() const { return sums_; }  ///< {Σ weight · value, Σ weight}
  /// The trials of each cluster by their weights, on average over the runs.
  Trials trials() const;
  /// Interval of the mean of values in [0, 1]. Without any trial: 0 in [0, 1].
  Interval interval() const;
  /// Interval of the mean of any values; infinite for a single cluster.
  Interval mean_interval() const;

 private:
  SumsByCrossing sums_;
};

/// Two-sided p value of "there is no difference", by Student's t over `clusters`; 1 where nothing is known.
double p_value(const Interval& difference, int clusters);
/// The smallest true difference whose interval excludes 0 in 80 % of sets as large and as scattered as the
/// one that gave this interval: (t(97.5 %) + t(80 %)) standard errors. 1 where nothing is known.
double detectable_difference(const Interval& difference, int clusters);
/// Holm's adjusted p values, in the order of `p` (Scandinavian Journal of Statistics 6, 1979).
std::vector<double> holm(std::span<const double> p);

/// Σ factor · share, paired by cluster and run. Zero degrees of freedom if a share has no trial.
Estimate combined_estimate(std::span<const ClusteredShare> shares, std::span<const double> factors);
/// Its interval, not clipped; infinite if a share has no trial.
Interval combined_shares(std::span<const ClusteredShare> shares, std::span<const double> factors);
/// share(a) − share(b), as above but in [-1, 1]. 0 in [-1, 1] where either has no trial.
Interval share_difference(const ClusteredShare& a, const ClusteredShare& b);

/// The median (of an even number the mean of the two in the middle) of independent values, one a cluster,
/// with the narrowest pair of them, equally far from both ends, that holds the true median with 95 % or more
/// (binomial; Conover, Practical Nonparametric Statistics, 1999, section 3.2). Of fewer than six values no
/// pair does, and both ends are infinite. InputError without any value.
Interval median_interval(std::vector<double> values);

/// The ⌈q·n⌉-th smallest of n > 0 values (q ≤ 0: the smallest; q ≥ 1: the largest).
double quantile(std::vector<double> values, double q);
/// The value that ⌊p·n⌋ of the n values lie below, the largest at most; 0 without values.
template <class T>
T lower_quantile(std::vector<T> values, double p) {
  if (values.empty()) return 0;
  const auto rank = static_cast<std::size_t>(p * static_cast<double>(values.size()));
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(std::min(values.size() - 1, rank));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

// Items by their group.

/// Brings the items of each group together, in their former order. Returns the index at which each group
/// starts, then the number of items. group_of(item): in [0, groups).
template <class Item, class GroupOf>
std::vector<int> group_together(std::vector<Item>& items, std::size_t groups, const GroupOf& group_of) {
  std::vector<int> first(groups + 1, 0);
  for (const Item& item : items) ++first[as_size(group_of(item)) + 1];
  for (std::size_t i = 1; i < first.size(); ++i) first[i] += first[i - 1];
  std::vector<Item> grouped(items.size());
  std::vector<int> next(first.begin(), first.end() - 1);
  for (const Item& item : items) grouped[as_size(next[as_size(group_of(item))]++)] = item;
  items = std::move(grouped);
  return first;
}

// How every command groups observations into clusters.
//
// A drive's frames show the same cars again and again, so boxes are no independent trials. If the data set
// has identities (training/track_2, scene/data/kitti.h), all observations of one vehicle, in any frame, are
// one cluster. Boxes of unknown identity and a detector's false alarms belong to their frame's cluster. In a
// data set without identities each frame is a cluster.
//
// Frames that share a vehicle are not merged into one cluster. Along a drive all of them would be (25 frames
// in a row are connected through their cars), and a single cluster has no spread to estimate from. An effect
// of a frame on all its vehicles is therefore not in the interval of a set with identities.

/// Name of the cluster of something seen in `frame`. `track`: the vehicle's identity; negative: unknown, or
/// of no vehicle. Without identities the names are the frames', in their order.
std::string cluster_of(const std::string& frame, int track);

/// The clusters that an interval rests on.
struct ClusterCount {
  std::string by = "frame";  ///< "vehicle" once an identity was known
  int count = 0;             ///< clusters with at least one counted observation
};

/// Collects the clusters of counted observations, to report the basis of an interval.
class Clusters {
 public:
  /// Adds an observation that counts; arguments as cluster_of.
  void add(const std::string& frame, int track);
  /// The different clusters so far.
  ClusterCount count() const;

 private:
  bool by_vehicle_ = false;
  std::set<std::string> names_;
};

/// "42 frames"; under kFewClusters "7 frames only: intervals are wide and approximate".
std::string to_string(const ClusterCount& clusters);
/// {"by": "vehicle" or "frame", "count": N}
nlohmann::json to_json(const ClusterCount& clusters);
/// Its inverse. InputError, naming file and field, for anything else.
ClusterCount cluster_count_from_json(const JsonFields& fields);

}  // namespace mirage
