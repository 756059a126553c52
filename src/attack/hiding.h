// What "hidden" means. A host is hidden when the detector found it in the frame as recorded and does not find
// it with the adversary on its roof; what counts as found is one of several rules, because a box that was
// only turned or moved a little is a miss at IoU 0.7 and no danger in traffic:
//     vanished             best IoU (or what else Matching compares by) of a detection with the host's box >
//     0.1: no box stands there any more iou50, iou70         > 0.5; > 0.7, the seed's (Tu et al., CoRL 2021,
//     section 4) distance1m, …2m      a detection's centre lies within 1 or 2 m of the host's (nuScenes'
//     matching:
//                          Caesar et al., CVPR 2020), however its box is turned
// Each rate has its own denominator: the hosts that its rule finds clean. In the picture there are no
// metres, and no rates by distance.
#pragma once

#include <array>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>

#include "base/intervals.h"

namespace mirage {

struct HostOutcome;

/// What counts as found: an IoU above `iou`, or with `distance` > 0 a centre within so many metres.
struct HidingRule {
  const char* name;
  double iou = 0, distance = 0;
  /// Given the best IoU of a detection, and m to the nearest one's centre.
  bool finds(double best_iou, double nearest) const {
    return distance > 0 ? nearest <= distance : best_iou > iou;
  }
  /// In the frame as recorded (`clean`) or with the adversary.
  bool finds(const HostOutcome& host, bool clean) const;
};

/// All of them, in the order of HidingRates.
inline constexpr std::array<HidingRule, 5> kHidingRules = {
    {{"vanished", 0.1, 0}, {"iou50", 0.5, 0}, {"iou70", 0.7, 0}, {"distance1m", 0, 1}, {"distance2m", 0, 2}}};

/// Of the hosts that a rule finds clean, those that it does not find attacked.
struct HidingRate {
  Interval share;    ///< 95 % (base/intervals.h)
  int vehicles = 0;  ///< found clean by this rule: the denominator of one mesh
};

/// By each rule; those by distance only where boxes lie in space.
struct HidingRates {
  HidingRate vanished, iou50, iou70;
  std::optional<HidingRate> distance1m, distance2m;
};

/// Over outcomes of one mesh or, a mesh after the other, of several.
HidingRates hiding_rates(std::span<const HostOutcome> hosts);

/// {"vanished": {value, low, high, vehicles}, "iou50", "iou70", "distance1m", "distance2m"}, the last two
/// null in the picture.
nlohmann::json to_json(const HidingRates& rates);

/// How much more often one mesh works than others on the same hosts: rate(learned) − rate(other) by each of
/// the rules above, and of FN ASR, FP ASR and ASR (attack/evaluation.h). Paired (share_difference).
struct NetSuccess {
  Interval vanished, iou50, iou70;
  std::optional<Interval> distance1m, distance2m;
  Interval fn, false_positive, asr;
};
/// Both are of the same hosts, in any order, each with as many meshes as it has.
NetSuccess net_success(std::span<const HostOutcome> learned, std::span<const HostOutcome> other);
/// {"vanished": {value, low, high}, …, "fn_asr", "fp_asr", "asr"}
nlohmann::json to_json(const NetSuccess& net);

}  // namespace mirage
