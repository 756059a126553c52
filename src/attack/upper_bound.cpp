#include "attack/upper_bound.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/math/distributions/binomial.hpp>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <numeric>

#include "attack/hiding.h"
#include "base/intervals.h"

namespace mirage {
namespace {

/// The largest binomial share of `trials` whose lower tail at `hits` is not below what `single` asks.
double binomial_bound(double trials, double hits, bool single) {
  const double alpha = (1 - kConfidence) / (single ? 1 : std::numbers::e), whole = std::ceil(hits - 1e-9);
  if (whole >= trials) return 1;
  return boost::math::binomial::find_upper_bound_on_p(trials, whole, alpha);
}

}  // namespace

ShareBound share_bound(std::span<const double> shares, bool single) {
  ShareBound bound{0, 0, 1, static_cast<int>(shares.size()), single};
  if (shares.empty()) return bound;
  const double sum = std::accumulate(shares.begin(), shares.end(), 0.0);
  bound.value = sum / bound.clusters;
  bound.high = binomial_bound(bound.clusters, sum, single);
  bound.low = 1 - binomial_bound(bound.clusters, bound.clusters - sum, single);
  return bound;
}

double clusters_for(double at_most, double value, bool single) {
  if (value >= at_most) return std::numeric_limits<double>::infinity();
  double enough = 1, few = 0;
  while (binomial_bound(enough, value * enough, single) > at_most) few = enough, enough *= 2;
  while (enough - few > 1) {
    const double middle = std::floor((few + enough) / 2);
    (binomial_bound(middle, value * middle, single) > at_most ? few : enough) = middle;
  }
  return enough;
}

std::optional<long> planned(double wanted) {
  wanted = std::ceil(wanted);
  if (!(wanted <= 1e6)) return std::nullopt;
  const double digit = std::pow(10, std::max(0.0, std::floor(std::log10(std::max(1.0, wanted))) - 1));
  return static_cast<long>(std::ceil(wanted / digit) * digit);
}

std::optional<long> vehicles_to_tell(double vehicles, double detectable, double difference) {
  const double times = detectable / difference;
  return planned(vehicles * times * times);
}

HiddenBound hidden_bound(std::span<const HostOutcome> hosts, double nearest, double farthest) {
  const HidingRule& vanished = kHidingRules[0];
  std::map<HostId, std::pair<std::string, bool>> cars;  // cluster, and whether any mesh hides it
  HiddenBound bound;
  bound.nearest = nearest, bound.farthest = farthest;
  for (const HostOutcome& host : hosts) {
    if (host.range < nearest || host.range >= farthest || !vanished.finds(host, true)) continue;
    auto& car = cars[host.id];
    car.first = host.cluster();
    car.second = car.second || !vanished.finds(host, false);
    if (host.track >= 0) bound.by = "vehicle";
  }
  std::map<std::string, std::pair<int, int>> clusters;  // cars, hidden ones
  for (const auto& [id, car] : cars) {
    ++clusters[car.first].first;
    clusters[car.first].second += car.second;
  }
  std::vector<double> shares;
  for (const auto& [name, of] : clusters)
    shares.push_back(static_cast<double>(of.second) / static_cast<double>(of.first));
  bound.vehicles = static_cast<int>(cars.size());
  bound.share = share_bound(shares, cars.size() == clusters.size());
  for (const double at_most : {0.1, 0.05, 0.02, 0.01})
    bound.needed.push_back({at_most, clusters_for(at_most, bound.share.value, bound.share.single)});
  return bound;
}

std::string describe(const HiddenBound& bound) {
  if (bound.vehicles == 0) return fmt::format("no car within {:g} m is found as recorded", bound.farthest);
  std::string text = fmt::format(
      "at most {:.1f} % of cars within {:g} m vanish (95 %, exact over {} {}s; seen: {:.1f} %)",
      100 * bound.share.high, bound.farthest, bound.share.clusters, bound.by, 100 * bound.share.value);
  for (const auto& [at_most, clusters] : bound.needed)
    if (at_most < bound.share.high && std::isfinite(clusters))
      return text + fmt::format(": {:.0f} {}s for {:g} %", clusters, bound.by, 100 * at_most);
  return text;
}

nlohmann::json to_json(const HiddenBound& bound) {
  nlohmann::json needed = nlohmann::json::array();
  for (const auto& [at_most, clusters] : bound.needed)
    needed.push_back({{"at_most", at_most},
                      {"clusters", std::isfinite(clusters) ? nlohmann::json(clusters) : nlohmann::json()}});
  return {{"at_most", bound.share.high},
          {"at_least", bound.share.low},
          {"value", bound.share.value},
          {"from_m", bound.nearest},
          {"within_m", bound.farthest},
          {"vehicles", bound.vehicles},
          {"clusters", to_json(ClusterCount{bound.by, bound.share.clusters})},
          {"needed", needed}};
}

}  // namespace mirage
