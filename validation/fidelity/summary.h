// What the results of all vehicles of a validation say together.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "frames/hosts.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

// The verdict on the attack: how often the detector is fooled by the rasteriser's pictures, by each rung of
// the ladder and by full Cycles, with intervals; which vehicles' outcome depends on who drew them.

/// Of vehicles found without the adversary: hidden; with a false positive; either. Intervals are drawn over
/// clusters, by the vehicles' track if they have one (base/intervals.h).
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

/// What is looked at (VerdictCondition, VerdictControl) against the first condition, as the attack was
/// learned, on the same vehicles.
template <class Key>
struct Compared : Success {
  Key key;
  std::optional<Interval> difference;  ///< asr − that of the first condition, paired; none of the first
  int flips = 0;                       ///< how many end otherwise, hidden or with a false positive
  double mean_delta_logit = 0, mean_delta_score = 0;  ///< of |Δ|
};

/// A set of vehicles found without the adversary.
struct VerdictGroup {
  int frames = 0, vehicles = 0;
  ClusterCount clusters;
  std::vector<VerdictVariant> variants;  ///< by kind, rungs in the ladder's order; none without vehicles
  std::vector<Compared<VerdictCondition>> conditions;
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
  /// channel's controls, and the mean |Δlogit| stays below kMinDeltaLogit (detection/reliance.h) under
  /// each. Then who drew the object there says nothing about the attack. None without controls.
  std::optional<bool> vacuous(Channel channel) const;
  /// The condition nearest to what is driven through: realistic returns, Cycles' picture if the detector
  /// `sees`, else the rasteriser's. None without vehicles.
  const Compared<VerdictCondition>* nearest_to_reality(bool sees) const;
};

/// `test_frames`: those whose vehicles are held back.
Verdict verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames);

/// {confidence, held_back, all, pairs, flips, of, arms, controls, vacuous}: the structs' fields by name, with
///   difference: of a group {fn_asr, fp_asr, asr}; of a condition or a control one interval, none of the
///   first condition; told: what a difference of asr says (base/intervals.h); pairs, flips: with split,
///   "test" or "train"; flips with from and to, "hidden" or "found"; of: "held_back" or "all", the judged
///   group, whose arms stand here again; vacuous: {image, lidar, bound}.
nlohmann::json to_json(const Verdict& verdict);

/// Rasteriser and rays against the reference's, light for light (MatchedResult), over the vehicles: errors
/// over all their pixels, or the largest.
struct MatchedSummary : MatchedResult {
  double mask_iou_worst = 1;  ///< of a vehicle
};

/// The same of one camera of frames with several; without rays of the LiDAR.
struct CameraSummary {
  std::string camera;
  int vehicles = 0;  ///< that it sees
  MatchedSummary matched;
};

/// What matched light is to reach.
struct Target {
  std::string place;   ///< of the figure in result.json
  std::string camera;  ///< empty: all together
  double bound = 0;
  std::optional<bool> met;  ///< none where nothing was measured: no pixel, no ray, no return
};

/// Means of a Change (ladders.h). `psnr`: of the pictures that differ; none where all are equal, or
/// where it is not measured.
struct MeanChange {
  double mae = 0, relative = 0, ssim = 0, flip = 0;
  std::optional<double> psnr;
};

/// What an interval is drawn over.
enum class IntervalBasis { pixels, vehicles, clusters };
constexpr auto words_of(IntervalBasis) {
  return std::to_array<const char*>({"pixels", "vehicles", "clusters"});
}

/// Squared errors (unbiased_error.h) over vehicles: their means, as roots, and the interval of the unbiased
/// one over clusters (base/intervals.h); of a single cluster over its vehicles, of a single
/// vehicle over its picture.
struct PooledError {
  double plain = 0, floor = 0, drawn = 0;
  Interval unbiased;
  IntervalBasis over = IntervalBasis::pixels;
};

/// The rasteriser's picture against full Cycles.
struct FullSummary {
  MeanChange change;
  double seconds = 0;                ///< of Cycles' picture
  std::optional<PooledError> error;  ///< none without vehicles
};

/// A rung over the vehicles that have it. What the detector says is of those found without the adversary;
/// `score_change` is the mean |Δ| from its score of the rasteriser's picture.
struct RungSummary {
  std::string effect;
  int vehicles = 0, detected = 0, hidden = 0, false_positive = 0;
  double fn_asr = 0, asr = 0, mean_score = 0, score_change = 0;
  double seconds = 0;
  std::optional<double> logit;  ///< mean; none where `detected` is 0
};
/// Of the ladder of light (LightRungResult).
struct LightRungSummary : RungSummary {
  std::string group, base;
  MeanChange change, crop, to_full;
  PooledError error;
};
/// Of the LiDAR's (LidarRungResult).
struct LidarRungSummary : RungSummary {
  double returns = 0, changed = 0, returns_change = 0;
};

/// How many vehicles the adversary fools, drawn by the rasteriser and by Cycles.
struct FooledSummary {
  int detected_clean = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0;
  int fooled_raster = 0, fooled_cycles = 0;
  /// Of those found without the adversary, in [0, 1].
  double share(int count) const { return count / (detected_clean > 0 ? double(detected_clean) : 1); }
};

/// Over the vehicles that show anything of the object.
struct ValidationSummary {
  int frames = 0, test_frames = 0, vehicles = 0;
  RoofCount rooftops;
  MatchedSummary matched;
  std::vector<CameraSummary> cameras;  ///< by name; none of frames with one camera
  FullSummary full;
  double noise = 0;                         ///< of full Cycles, mean share of the object's radiance
  int least_samples = 0, most_samples = 0;  ///< a pixel, that full Cycles took on a vehicle
  std::vector<LightRungSummary> ladder;
  std::vector<LidarRungSummary> lidar_ladder;
  FooledSummary attack, attack_train;  ///< held-back vehicles, and those that the attack saw
};

/// Each camera's mean error in matched light is to be within the bound, too.
std::vector<Target> targets_of(const ValidationSummary& summary);

/// `test_frames`: frames that the attack never saw. Rungs are in the order of the ladders.
ValidationSummary summarize_vehicles(const std::vector<VehicleResult>& vehicles,
                                     const std::set<std::string>& test_frames);

/// As result.json has it (src/README.md): an error's figures stand among the rung's, beside those of its
/// change.
nlohmann::json to_json(const ValidationSummary& summary);

}  // namespace mirage
