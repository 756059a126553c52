#include "attack/host_outcome.h"

#include <algorithm>

#include "base/intervals.h"

namespace mirage {

SuccessRates success_rates(std::span<const HostOutcome* const> hosts, std::optional<double> iou) {
  ClusteredShare fn, fp, either;
  int meshes = 1;
  for (const HostOutcome* host : hosts) meshes = std::max(meshes, host->mesh + 1);
  for (const HostOutcome* host : hosts) {
    if (!(iou ? host->clean_iou > *iou : host->detected)) continue;
    const bool hidden = iou ? host->attacked_iou <= *iou : host->hidden;
    fn.add(host->cluster(), hidden, 0, 1.0 / meshes);
    fp.add(host->cluster(), host->false_positive, 0, 1.0 / meshes);
    either.add(host->cluster(), hidden || host->false_positive, 0, 1.0 / meshes);
  }
  return {fn.interval(), fp.interval(), either.interval()};
}

namespace {

std::vector<double> even_edges(double last, int bins) {
  std::vector<double> edges;
  for (int i = 0; i <= bins; ++i) edges.push_back(last * i / bins);
  return edges;
}

/// The box and how far it is off, by the names it has from above or in the picture.
nlohmann::json box_json(const NewBox& new_box, bool in_picture) {
  if (in_picture) {
    const PictureBox& box = new_box.box.picture;
    return {{"left", box.left},
            {"top", box.top},
            {"right", box.right},
            {"bottom", box.bottom},
            {"distance_from_host_px", new_box.distance}};
  }
  const auto& [x, y, length, width, yaw] = new_box.box.box.bev;
  return {{"x", x},
          {"y", y},
          {"length", length},
          {"width", width},
          {"yaw", yaw},
          {"distance_from_host", new_box.distance},
          {"distance_from_sensor", new_box.range}};
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
      nlohmann::json entry = box_json(box, host.matching.in_picture());
      entry.update(
          {{"frame", host.id.frame}, {"label", host.id.label}, {"mesh", host.mesh}, {"score", box.score}});
      list.push_back(std::move(entry));
    }
  }
  const bool any = !list.empty();
  nlohmann::json result = {{"vehicles", vehicles},
                           {"boxes", list.size()},
                           {"score", to_json(distribution(scores, even_edges(1, 10)), any)},
                           {"list", list}};
  if (!hosts.empty() && hosts.front().matching.in_picture()) {
    result["distance_from_host_px"] = to_json(distribution(from_host, even_edges(1000, 20)), any);
  } else {
    result["distance_from_host"] = to_json(distribution(from_host, even_edges(100, 20)), any);
    result["distance_from_sensor"] = to_json(distribution(from_sensor, even_edges(100, 20)), any);
  }
  return result;
}

}  // namespace mirage
