// What a detector says of one host, clean and attacked (attack/evaluation.h has the definitions of success).
#pragma once

#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/clusters.h"
#include "base/intervals.h"
#include "detection/detector.h"
#include "frames/host_id.h"

namespace mirage {

/// A false positive: a detection that the adversary made.
struct NewBox {
  ObjectBoxes box;
  double score = 0;
  double distance = 0;  ///< m (in the picture: pixels), from the host's centre to the box's
  double range = 0;     ///< m, from the `velo` origin; 0 in the picture
};

/// What the detector says about one host, clean and attacked.
struct HostOutcome {
  HostId id;
  int mesh = 0;            ///< which of the judged meshes
  int victim = -1;         ///< Victim::neighbour: the label that is judged in the host's place; -1: the host
  int track = -1;          ///< the label's (here and below the victim's)
  bool from_box = true;    ///< the roof's pose is the labelled box's (Carrier)
  double range = 0;        ///< m, host's box centre from the `velo` origin
  int occluded = 0;        ///< the label's
  double truncated = 0;    ///< the label's
  std::string kind;        ///< EvaluationSettings::kinds
  Matching matching = {};  ///< how the detector was judged
  double clean_iou = 0, attacked_iou = 0;      ///< best IoU of a detection with the host's box
  double clean_score = 0, attacked_score = 0;  ///< score of that detection
  /// m, from the host's centre to that of the nearest detection; infinite without any and in the picture.
  double clean_distance = std::numeric_limits<double>::infinity(),
         attacked_distance = std::numeric_limits<double>::infinity();
  bool detected = false, hidden = false, false_positive = false;
  double false_positive_distance = 0;      ///< from the host to the farthest new box, if any (NewBox)
  std::vector<NewBox> new_boxes;           ///< in the order of `attacked`
  std::vector<Detection> clean, attacked;  ///< detections after suppression

  /// What it is counted with (base/clusters.h).
  std::string cluster() const { return cluster_of(id.frame, track); }
  /// Whether the attack worked on this host, in either way: what ASR counts.
  bool fooled() const { return hidden || false_positive; }
};

// Success rates over outcomes (attack/evaluation.h has their definitions).

/// Shares of the vehicles that were detected clean, with 95 % intervals (base/clusters.h).
struct SuccessRates {
  Interval fn_asr, fp_asr, asr;
};
/// Over those outcomes that count: `hosts` whose detection was clean. With `iou`, as if that were
/// EvaluationSettings::detected_iou.
SuccessRates success_rates(std::span<const HostOutcome* const> hosts, std::optional<double> iou = {});

// Where the detections are that an adversary made.

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
