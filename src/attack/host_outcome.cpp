#include "attack/host_outcome.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/math/distributions/binomial.hpp>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <set>

#include "base/sizes.h"
#include "detection/average_precision.h"
#include "scene/data/kitti_rows.h"

namespace mirage {

bool is_road_user(const Label& label) {
  return label.type != "DontCare" && label.type != "Misc";
}

namespace {

constexpr double kCarHeight = 1.5;  // m

std::vector<double> even_edges(double last, int bins) {
  std::vector<double> edges;
  for (int i = 0; i <= bins; ++i) edges.push_back(last * i / bins);
  return edges;
}

/// The box and its distances, with the keys of the bird's-eye view or the picture.
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

/// Share of the hosts with `counts` for which `works` holds.
ClusteredShare share_of(std::span<const HostOutcome> hosts, const OutcomeTest& counts,
                        const OutcomeTest& works) {
  ClusteredShare share;
  std::set<int> meshes;  // a vehicle's weights sum to 1
  for (const HostOutcome& host : hosts)
    if (counts(host)) meshes.insert(host.mesh);
  for (const HostOutcome& host : hosts)
    if (counts(host)) share.add(host.cluster(), works(host), 0, 1.0 / static_cast<double>(meshes.size()));
  return share;
}

/// Vehicles of the first mesh: all meshes have the same vehicles as recorded.
int vehicles_of(std::span<const HostOutcome> hosts, const OutcomeTest& counts) {
  int vehicles = 0;
  std::optional<int> mesh;
  for (const HostOutcome& host : hosts)
    if (counts(host)) vehicles += host.mesh == mesh.emplace(mesh.value_or(host.mesh));
  return vehicles;
}

MissRate rate(std::span<const HostOutcome> hosts, const MissCriterion& rule) {
  const auto found_clean = [&](const HostOutcome& host) { return rule.finds(host, true); };
  const ClusteredShare hidden =
      share_of(hosts, found_clean, [&](const HostOutcome& host) { return !rule.finds(host, false); });
  return {hidden.interval(), vehicles_of(hosts, found_clean)};
}

Interval paired(std::span<const HostOutcome> a, std::span<const HostOutcome> b, const OutcomeTest& counts,
                const OutcomeTest& works) {
  return share_difference(share_of(a, counts, works), share_of(b, counts, works));
}

bool has_metres(std::span<const HostOutcome> hosts) {
  return hosts.empty() || !hosts.front().matching.in_picture();
}

/// The upper binomial bound for `hits` of `trials`, at the level for `single` (ShareBound).
double binomial_bound(double trials, double hits, bool single) {
  const double alpha = (1 - kConfidence) / (single ? 1 : std::numbers::e), whole = std::ceil(hits - 1e-9);
  if (whole >= trials) return 1;
  return boost::math::binomial::find_upper_bound_on_p(trials, whole, alpha);
}

}  // namespace

std::optional<PictureBox> silhouette_box(const Simulated& simulated) {
  const Image<double>& rgba = simulated.rgba;
  const int last_column = simulated.image.width - 1, last_row = simulated.image.height - 1;
  PixelRect rect{last_column + 1, last_row + 1, 0, 0};
  for (int y = 0; y < rgba.height; ++y)
    for (int x = 0; x < rgba.width; ++x) {
      const int u = simulated.rect.u0 + x, v = simulated.rect.v0 + y;
      if (!(rgba.at(x, y, 3) > 0.5) || u < 0 || v < 0 || u > last_column || v > last_row) continue;
      rect = {std::min(rect.u0, u), std::min(rect.v0, v), std::max(rect.u1, u + 1), std::max(rect.v1, v + 1)};
    }
  if (rect.empty()) return std::nullopt;
  return PictureBox{std::max(0.0, rect.u0 - 0.5), std::max(0.0, rect.v0 - 0.5),
                    std::min<double>(last_column, rect.u1 - 0.5), std::min<double>(last_row, rect.v1 - 0.5)};
}

std::optional<PictureBox> carried_box(const Simulated& simulated, const Placement& placement) {
  return placement.support == Support::roof || placement.grows_box ? silhouette_box(simulated) : std::nullopt;
}

HostTruth::HostTruth(const Frame& frame, const Label& host, Matching matching,
                     const std::optional<PictureBox>& object)
    : matching_(matching), host_({boxes_of(host)}), ground_(host.box.bottom) {
  for (const Label& label : frame.labels) {
    if (label.type == "DontCare") dont_care_.push_back(boxes_of(label));
    if (is_road_user(label) && (matching.in_picture() || has_box(label))) labels_.push_back(boxes_of(label));
  }
  if (!matching.in_picture()) {
    calibration_ = frame.calibration;
  } else if (object) {
    host_.emplace_back(united(picture_box(host), *object));
    labels_.push_back(host_.back());
  }
}

HostTruth HostTruth::with_box(const Frame& frame, const Label& host, Matching matching, const BevBox& grown,
                              const std::optional<PictureBox>& object) {
  HostTruth truth(frame, host, matching, object);
  if (matching.in_picture()) {
    if (truth.host_.size() > 1) truth.host_.erase(truth.host_.begin());  // leaves the united box
  } else {
    truth.host_.front() = ObjectBoxes(grown);
    truth.labels_.push_back(truth.host_.front());
  }
  return truth;
}

HostTruth HostTruth::of_object(const Frame& frame, const Label& object, Matching matching) {
  HostTruth truth(frame, object, matching);
  truth.labels_.push_back(truth.host_.front());
  return truth;
}

double HostTruth::largest(const ObjectBoxes& found, const std::vector<ObjectBoxes>& others) const {
  double most = 0;
  for (const ObjectBoxes& other : others) most = std::max(most, matching_.overlap(found, other));
  return most;
}

double HostTruth::host_iou(const ObjectBoxes& found) const {
  return largest(found, host_);
}

double HostTruth::label_iou(const ObjectBoxes& found) const {
  if (!matching_.in_picture()) return largest(found, labels_);
  if (in_dont_care(found)) return 1;
  return std::max(largest(found, labels_), largest(found, dont_care_));
}

bool HostTruth::in_dont_care(const ObjectBoxes& found) const {
  if (dont_care_.empty()) return false;
  ObjectBoxes seen = found;
  if (!matching_.in_picture()) {
    Box3 box = found.box;
    if (!(box.height > 0)) box.bottom = ground_, box.height = kCarHeight;
    const auto there = projected(box, calibration_);
    if (!there) return false;
    seen.picture = *there;
  }
  return std::ranges::any_of(dont_care_, [&](const ObjectBoxes& region) {
    return kInPicture.intersection(seen, region) >= kInPicture.area(seen) / 2;
  });
}

SuccessRates success_rates(std::span<const HostOutcome> hosts, std::optional<double> iou,
                           const OutcomeTest& of) {
  const auto counts = [&](const HostOutcome& host) {
    return of(host) && (iou ? host.clean_iou > *iou : host.detected);
  };
  const auto hidden = [&](const HostOutcome& host) { return iou ? host.attacked_iou <= *iou : host.hidden; };
  const auto new_box = [](const HostOutcome& host) { return host.false_positive; };
  SuccessRates rates;
  rates.fn_asr = share_of(hosts, counts, hidden).interval();
  rates.fp_asr = share_of(hosts, counts, new_box).interval();
  rates.asr = share_of(hosts, counts, [&](const HostOutcome& host) {
                return hidden(host) || new_box(host);
              }).interval();
  rates.vehicles = vehicles_of(hosts, counts);
  return rates;
}

Distribution distribution(const std::vector<double>& values, std::vector<double> edges) {
  Distribution result;
  result.counts.assign(edges.size() - 1, 0);
  for (const double value : values) {
    const auto above = std::upper_bound(edges.begin(), edges.end() - 1, value);
    ++result.counts[as_size(std::max<std::ptrdiff_t>(0, above - edges.begin() - 1))];
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
  nlohmann::json result = {{"vehicles", vehicles},
                           {"boxes", list.size()},
                           {"score", fields_json(distribution(scores, even_edges(1, 10)))},
                           {"list", list}};
  if (!hosts.empty() && hosts.front().matching.in_picture()) {
    result["distance_from_host_px"] = fields_json(distribution(from_host, even_edges(1000, 20)));
  } else {
    result["distance_from_host"] = fields_json(distribution(from_host, even_edges(100, 20)));
    result["distance_from_sensor"] = fields_json(distribution(from_sensor, even_edges(100, 20)));
  }
  return result;
}

bool MissCriterion::finds(const HostOutcome& host, bool clean) const {
  return clean ? finds(host.clean_iou, host.clean_distance)
               : finds(host.attacked_iou, host.attacked_distance);
}

MissRates miss_rates(std::span<const HostOutcome> hosts) {
  const auto of = [&](std::size_t rule) { return rate(hosts, kMissCriteria[rule]); };
  MissRates rates{of(0), of(1), of(2), {}, {}};
  if (has_metres(hosts)) rates.distance1m = of(3), rates.distance2m = of(4);
  return rates;
}

GainOverControl gain_over_control(std::span<const HostOutcome> learned, std::span<const HostOutcome> other) {
  const auto of = [&](std::size_t rule) {
    const MissCriterion& by = kMissCriteria[rule];
    return paired(
        learned, other, [&](const HostOutcome& host) { return by.finds(host, true); },
        [&](const HostOutcome& host) { return !by.finds(host, false); });
  };
  const OutcomeTest detected = [](const HostOutcome& host) { return host.detected; };
  GainOverControl net{of(0), of(1), of(2), {}, {}, {}, {}, {}};
  if (has_metres(learned)) net.distance1m = of(3), net.distance2m = of(4);
  net.fn = paired(learned, other, detected, [](const HostOutcome& host) { return host.hidden; });
  net.false_positive =
      paired(learned, other, detected, [](const HostOutcome& host) { return host.false_positive; });
  net.asr = paired(learned, other, detected, [](const HostOutcome& host) { return host.fooled(); });
  return net;
}

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

std::optional<long> rounded_up(double count) {
  count = std::ceil(count);
  if (!(count <= 1e6)) return std::nullopt;
  const double digit = std::pow(10, std::max(0.0, std::floor(std::log10(std::max(1.0, count))) - 1));
  return static_cast<long>(std::ceil(count / digit) * digit);
}

std::optional<long> sample_size(double vehicles, double detectable, double difference) {
  const double times = detectable / difference;
  return rounded_up(vehicles * times * times);
}

HiddenBound hidden_bound(std::span<const HostOutcome> hosts, double nearest, double farthest) {
  std::map<HostId, std::pair<std::string, bool>> cars;  // cluster, and whether any mesh hides it
  HiddenBound bound;
  bound.nearest = nearest, bound.farthest = farthest;
  for (const HostOutcome& host : hosts) {
    if (host.range < nearest || host.range >= farthest || !kVanished.finds(host, true)) continue;
    auto& car = cars[host.id];
    car.first = host.cluster();
    car.second = car.second || !kVanished.finds(host, false);
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
      return text +
             fmt::format("; about {:.0f} {}s would bound it by {:g} %", clusters, bound.by, 100 * at_most);
  return text;
}

}  // namespace mirage
