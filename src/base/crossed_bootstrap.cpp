#include "base/crossed_bootstrap.h"

#include <algorithm>

#include "base/bootstrap_draws.h"

namespace mirage {
namespace {

bool one_run(std::span<const Crossing> items) {
  return std::all_of(items.begin(), items.end(), [](const Crossing& item) { return item.run == 0; });
}

void add(ClusterSums& to, const ClusterSums& more, double times = 1) {
  to.numerator += times * more.numerator;
  to.denominator += times * more.denominator;
}

}  // namespace

std::vector<Crossing> crossings_of(std::span<const CrossingName> names) {
  std::map<std::string, std::size_t> clusters;
  std::map<int, std::size_t> runs;
  for (const auto& [cluster, run] : names) clusters[cluster], runs[run];
  std::size_t next = 0;
  for (auto& [name, number] : clusters) number = next++;
  next = 0;
  for (auto& [name, number] : runs) number = next++;
  std::vector<Crossing> items;
  for (const auto& [cluster, run] : names) items.push_back({clusters.at(cluster), runs.at(run)});
  return items;
}

Interval crossed_statistic(std::span<const Crossing> items,
                           const std::function<double(std::span<const int> drawn)>& statistic,
                           const BootstrapSettings& settings) {
  if (one_run(items)) return bootstrap_statistic(items.size(), statistic, settings);
  std::size_t clusters = 0, runs = 0;
  for (const Crossing& item : items) {
    clusters = std::max(clusters, item.cluster + 1);
    runs = std::max(runs, item.run + 1);
  }
  std::vector<int> of_cluster(clusters), of_run(runs);
  const auto draw = [&](std::uint64_t replicate, std::span<int> drawn) {
    RandomStream random(settings.seed, settings.purpose, replicate);
    draw_with_replacement(random, clusters, of_cluster);
    draw_with_replacement(random, runs - 1, of_run);
    for (std::size_t i = 0; i < items.size(); ++i)
      drawn[i] = of_cluster[items[i].cluster] * of_run[items[i].run];
  };
  return statistic_of_draws(items.size(), draw, statistic, settings);
}

Interval crossed_interval(const std::map<CrossingName, ClusterSums>& sums,
                          const BootstrapSettings& settings) {
  std::map<CrossingName, ClusterSums> used;
  for (const auto& [name, value] : sums)
    if (value.denominator > 0) used.emplace(name, value);
  const std::vector<Crossing> items = crossings(used);
  std::vector<ClusterSums> list;
  for (const auto& [name, value] : used) list.push_back(value);
  const bool same = std::all_of(list.begin(), list.end(), [&](const ClusterSums& cluster) {
    return cluster.numerator * list[0].denominator == list[0].numerator * cluster.denominator;
  });
  if (one_run(items) || same) {
    std::map<std::string, ClusterSums> by_name;
    for (const auto& [name, value] : used) add(by_name[name.first], value);
    list.clear();
    for (const auto& [name, value] : by_name) list.push_back(value);
    return bootstrap_interval(list, settings);
  }
  return crossed_statistic(
      items,
      [&](std::span<const int> drawn) {
        ClusterSums all;
        for (std::size_t i = 0; i < list.size(); ++i) add(all, list[i], drawn[i]);
        return all.numerator / all.denominator;  // NaN without any
      },
      settings);
}

Interval crossed_difference(const std::map<CrossingName, PairedSums>& sums,
                            const BootstrapSettings& settings) {
  std::map<CrossingName, PairedSums> used;
  PairedSums all;
  for (const auto& [name, value] : sums) {
    if (!(value.a.denominator > 0) && !(value.b.denominator > 0)) continue;
    used.emplace(name, value);
    add(all.a, value.a), add(all.b, value.b);
  }
  const std::vector<Crossing> items = crossings(used);
  std::vector<PairedSums> list;
  for (const auto& [name, value] : used) list.push_back(value);
  if (one_run(items)) return bootstrap_difference(list, settings);
  if (!(all.a.denominator > 0) || !(all.b.denominator > 0)) return {0, -1, 1};
  std::size_t clusters = 0;
  for (const Crossing& item : items) clusters = std::max(clusters, item.cluster + 1);
  const Interval result = crossed_statistic(
      items,
      [&](std::span<const int> drawn) {
        PairedSums drawn_sums;
        for (std::size_t i = 0; i < list.size(); ++i) {
          add(drawn_sums.a, list[i].a, drawn[i]);
          add(drawn_sums.b, list[i].b, drawn[i]);
        }
        return drawn_sums.a.numerator / drawn_sums.a.denominator -
               drawn_sums.b.numerator / drawn_sums.b.denominator;
      },
      settings);
  return with_unseen_spread(result, clusters, settings.confidence);
}

}  // namespace mirage
