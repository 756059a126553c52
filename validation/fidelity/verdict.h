// The verdict on the attack: how often the detector is fooled by the rasteriser's pictures, by each rung of
// the ladder and by full Cycles, with intervals; which vehicles' outcome depends on who drew them.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/clusters.h"
#include "base/intervals.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// Of vehicles found without the adversary: hidden; with a false positive; either. Intervals are drawn over
/// clusters, by the vehicles' track if they have one (base/clusters.h).
struct SuccessShares {
  Interval fn_asr, fp_asr, asr;
};
struct Success : SuccessShares {
  int vehicles = 0;
  double mean_score = 0;
};

/// The object as attacked ("soft") and with hard edges, in the picture of a rung of the ladder (over the
/// vehicles that have one), and in full Cycles.
enum class VariantKind { soft, hard, rung, cycles };
struct VerdictVariant : Success {
  VariantKind kind = VariantKind::soft;
  std::string name;  ///< the kind's, or the rung's effect
};

/// What is looked at (VerdictArm, VerdictControl) against the first arm, as the attack was learned, on the
/// same vehicles.
template <class Look>
struct Compared : Success {
  Look look;
  std::optional<Interval> difference;  ///< asr − that of the first arm, paired; none of the first itself
  int flips = 0;                       ///< how many end otherwise, hidden or with a false positive
  double mean_delta_logit = 0, mean_delta_score = 0;  ///< of |Δ|
};

/// A set of vehicles found without the adversary.
struct VerdictGroup {
  int frames = 0, vehicles = 0;
  ClusterCount clusters;
  std::vector<VerdictVariant> variants;  ///< by kind, rungs in the ladder's order; none without vehicles
  std::vector<Compared<VerdictArm>> arms;
  SuccessShares difference;                 ///< cycles − soft, paired
  double agree = 0;                         ///< share of the same outcome, soft and cycles
  std::optional<double> score_correlation;  ///< of the same two; none where one does not vary
  double score_mean_difference = 0;         ///< of |Δ|
};

/// The scores on a vehicle, found without the adversary or not; 0: no detection there.
struct ScorePair {
  std::string name, frame;
  bool held_back = false, detected = false;
  double clean = 0, soft = 0, hard = 0, cycles = 0;
};

/// A vehicle that is hidden under one of soft and cycles and found under the other.
struct VerdictFlip {
  std::string name, frame;
  bool held_back = false;
  double range = 0;  ///< m
  OutcomeResult soft, cycles;
  std::map<std::string, std::string> pictures;  ///< files, relative to OUT
};

struct Verdict {
  VerdictGroup held_back, all;
  std::vector<Compared<VerdictControl>> controls;  ///< over all vehicles
  std::vector<ScorePair> pairs;
  std::vector<VerdictFlip> flips;

  /// Which of the groups the verdict is on: all vehicles where none was held back.
  const VerdictGroup& judged() const { return held_back.vehicles > 0 ? held_back : all; }
  /// Whether taking the object out of that channel changes nothing: no outcome flips under any of the
  /// channel's controls, and the mean |Δlogit| stays below kLeastDeltaLogit (detection/reliance.h) under
  /// each. Then who drew the object there says nothing about the attack. None without controls.
  std::optional<bool> vacuous(Channel channel) const;
  /// The arm nearest to what is driven through: realistic returns, Cycles' picture if the detector `sees`,
  /// else the rasteriser's. None without vehicles.
  const Compared<VerdictArm>* nearest_to_reality(bool sees) const;
};

/// `test_frames`: those whose vehicles are held back.
Verdict verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames);

/// {confidence, held_back, all, pairs, flips, of, arms, controls, vacuous}: the structs' fields by name, with
///   difference: of a group {fn_asr, fp_asr, asr}; of an arm or a control one interval, none of the first
///   arm; told: what a difference of asr says (base/intervals.h); pairs, flips: with split, "test" or
///   "train"; flips with from and to, "hidden" or "found"; of: "held_back" or "all", the judged group, whose
///   arms stand here again; vacuous: {image, lidar, bound}.
nlohmann::json to_json(const Verdict& verdict);

}  // namespace mirage
