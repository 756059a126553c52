#include "attack/hiding.h"

#include <algorithm>
#include <functional>

#include "attack/host_outcome.h"

namespace mirage {
namespace {

using Test = std::function<bool(const HostOutcome&)>;

/// Of the hosts for which `counts` holds the share for which `works` does.
ClusteredShare share_of(std::span<const HostOutcome> hosts, const Test& counts, const Test& works) {
  ClusteredShare share;
  int meshes = 1;
  for (const HostOutcome& host : hosts) meshes = std::max(meshes, host.mesh + 1);
  for (const HostOutcome& host : hosts)
    if (counts(host)) share.add(host.cluster(), works(host), 0, 1.0 / meshes);
  return share;
}

HidingRate rate(std::span<const HostOutcome> hosts, const HidingRule& rule) {
  const auto found_clean = [&](const HostOutcome& host) { return rule.finds(host, true); };
  const ClusteredShare hidden =
      share_of(hosts, found_clean, [&](const HostOutcome& host) { return !rule.finds(host, false); });
  HidingRate result{hidden.interval(), 0};
  for (const HostOutcome& host : hosts)
    result.vehicles += host.mesh == hosts.front().mesh && found_clean(host);
  return result;
}

Interval paired(std::span<const HostOutcome> a, std::span<const HostOutcome> b, const Test& counts,
                const Test& works) {
  return share_difference(share_of(a, counts, works), share_of(b, counts, works));
}

bool has_metres(std::span<const HostOutcome> hosts) {
  return hosts.empty() || !hosts.front().matching.in_picture();
}

nlohmann::json rate_json(const HidingRate& rate) {
  nlohmann::json json = to_json(rate.share);
  json["vehicles"] = rate.vehicles;
  return json;
}

}  // namespace

bool HidingRule::finds(const HostOutcome& host, bool clean) const {
  return clean ? finds(host.clean_iou, host.clean_distance)
               : finds(host.attacked_iou, host.attacked_distance);
}

HidingRates hiding_rates(std::span<const HostOutcome> hosts) {
  const auto of = [&](std::size_t rule) { return rate(hosts, kHidingRules[rule]); };
  HidingRates rates{of(0), of(1), of(2), {}, {}};
  if (has_metres(hosts)) rates.distance1m = of(3), rates.distance2m = of(4);
  return rates;
}

nlohmann::json to_json(const HidingRates& rates) {
  const auto maybe = [](const std::optional<HidingRate>& rate) {
    return rate ? rate_json(*rate) : nlohmann::json();
  };
  return {{"vanished", rate_json(rates.vanished)},
          {"iou50", rate_json(rates.iou50)},
          {"iou70", rate_json(rates.iou70)},
          {"distance1m", maybe(rates.distance1m)},
          {"distance2m", maybe(rates.distance2m)}};
}

NetSuccess net_success(std::span<const HostOutcome> learned, std::span<const HostOutcome> other) {
  const auto of = [&](std::size_t rule) {
    const HidingRule& by = kHidingRules[rule];
    return paired(
        learned, other, [&](const HostOutcome& host) { return by.finds(host, true); },
        [&](const HostOutcome& host) { return !by.finds(host, false); });
  };
  const Test detected = [](const HostOutcome& host) { return host.detected; };
  NetSuccess net{of(0), of(1), of(2), {}, {}, {}, {}, {}};
  if (has_metres(learned)) net.distance1m = of(3), net.distance2m = of(4);
  net.fn = paired(learned, other, detected, [](const HostOutcome& host) { return host.hidden; });
  net.false_positive =
      paired(learned, other, detected, [](const HostOutcome& host) { return host.false_positive; });
  net.asr = paired(learned, other, detected, [](const HostOutcome& host) { return host.fooled(); });
  return net;
}

nlohmann::json to_json(const NetSuccess& net) {
  const auto maybe = [](const std::optional<Interval>& interval) {
    return interval ? to_json(*interval) : nlohmann::json();
  };
  return {{"vanished", to_json(net.vanished)},     {"iou50", to_json(net.iou50)},
          {"iou70", to_json(net.iou70)},           {"distance1m", maybe(net.distance1m)},
          {"distance2m", maybe(net.distance2m)},   {"fn_asr", to_json(net.fn)},
          {"fp_asr", to_json(net.false_positive)}, {"asr", to_json(net.asr)}};
}

}  // namespace mirage
