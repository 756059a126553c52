#include "attack/false_positives.h"

#include <algorithm>

#include "base/bootstrap.h"

namespace mirage {
namespace {

std::vector<double> even_edges(double last, int bins) {
  std::vector<double> edges;
  for (int i = 0; i <= bins; ++i) edges.push_back(last * i / bins);
  return edges;
}

nlohmann::json to_json(const Distribution& d, bool any) {
  return {{"edges", d.edges},
          {"counts", d.counts},
          {"median", any ? nlohmann::json(d.median) : nlohmann::json()},
          {"p90", any ? nlohmann::json(d.p90) : nlohmann::json()}};
}

}  // namespace

Distribution distribution(const std::vector<double>& values, std::vector<double> edges) {
  Distribution result;
  result.counts.assign(edges.size() - 1, 0);
  for (const double value : values) {
    const auto above = std::upper_bound(edges.begin(), edges.end() - 1, value);
    ++result.counts[static_cast<std::size_t>(std::max<std::ptrdiff_t>(0, above - edges.begin() - 1))];
  }
  if (!values.empty()) {
    result.median = quantile(values, 0.5);
    result.p90 = quantile(values, 0.9);
  }
  result.edges = std::move(edges);
  return result;
}

nlohmann::json false_positives_json(const std::vector<HostOutcome>& hosts) {
  std::vector<double> from_host, from_sensor, scores;
  auto list = nlohmann::json::array();
  int vehicles = 0;
  for (const HostOutcome& host : hosts) {
    if (!host.detected) continue;
    vehicles += host.false_positive;
    for (const NewBox& box : host.new_boxes) {
      from_host.push_back(box.distance);
      from_sensor.push_back(box.range);
      scores.push_back(box.score);
      list.push_back({{"frame", host.id.frame},
                      {"label", host.id.label},
                      {"mesh", host.mesh},
                      {"x", box.box.x},
                      {"y", box.box.y},
                      {"length", box.box.length},
                      {"width", box.box.width},
                      {"yaw", box.box.yaw},
                      {"score", box.score},
                      {"distance_from_host", box.distance},
                      {"distance_from_sensor", box.range}});
    }
  }
  const bool any = !list.empty();
  return {{"vehicles", vehicles},
          {"boxes", list.size()},
          {"distance_from_host", to_json(distribution(from_host, even_edges(100, 20)), any)},
          {"distance_from_sensor", to_json(distribution(from_sensor, even_edges(100, 20)), any)},
          {"score", to_json(distribution(scores, even_edges(1, 10)), any)},
          {"list", list}};
}

}  // namespace mirage
