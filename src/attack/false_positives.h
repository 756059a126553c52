// Where the detections are that an adversary made.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "attack/host_outcome.h"

namespace mirage {

/// A histogram with its median and 90th percentile (order statistics: the ⌈q·n⌉-th value).
struct Distribution {
  std::vector<double> edges;  ///< bin k is [edges[k], edges[k + 1]); the last one takes what lies beyond, too
  std::vector<int> counts;
  double median = 0, p90 = 0;  ///< 0 without values
};
/// Counts finite values into bins; `edges` rise and are at least two.
Distribution distribution(const std::vector<double>& values, std::vector<double> edges);

/// New boxes of the hosts that were detected clean, those that FP ASR counts:
/// {vehicles, boxes, distance_from_host, distance_from_sensor, score, list}. `vehicles`: outcomes with at
/// least one; distances in m, each a distribution {edges, counts, median, p90} (null without boxes); `list`:
/// every box with its host {frame, label, mesh}, box, score and the two distances. Of a detector that is
/// judged in the picture the boxes are {left, top, right, bottom}, distance_from_host_px stands for
/// distance_from_host (pixels), and there is no distance_from_sensor.
nlohmann::json false_positives_json(const std::vector<HostOutcome>& hosts);

}  // namespace mirage
