// The summary of the results of all vehicles of a validation.
#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/intervals.h"
#include "frames/hosts.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

// The verdict on the attack: how often the detector is fooled by the rasteriser's pictures, by each rung of
// the ladder and by full Cycles, with intervals; which vehicles' outcome depends on the renderer.

/// Shares of the vehicles found without the adversary: hidden; with a false positive; either. Intervals are
/// drawn over clusters, by the vehicles' track if they have one (base/intervals.h).
struct SuccessShares {
  Interval fn_asr, fp_asr, asr;
};
template <class Visitor, FieldsOf<SuccessShares> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "fn_asr", s.fn_asr, "fp_asr", s.fp_asr, "asr", s.asr);
}
struct Success : SuccessShares {
  int vehicles = 0;
  double mean_score = 0;
};
template <class Visitor, FieldsOf<Success> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<SuccessShares>(s));
  visit_named(visit, "vehicles", s.vehicles, "mean_score", s.mean_score);
}

/// The object as attacked ("soft") and with hard edges, in the picture of a rung of the ladder (over the
/// vehicles that have one), and in full Cycles.
enum class VariantKind { soft, hard, rung, cycles };
struct VerdictVariant : Success {
  VariantKind kind = VariantKind::soft;
  std::string name;  ///< the kind's, or the rung's effect
};
template <class Visitor, FieldsOf<VerdictVariant> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<Success>(s));
  visit({.name = "name"}, s.name);
}

/// A RenderCondition or VerdictControl against the first condition, as the attack was learned, on the same
/// vehicles.
template <class Key>
struct Compared : Success {
  Key key;
  std::optional<Interval> difference;  ///< asr − that of the first condition, paired; empty for the first
  int flips = 0;                       ///< vehicles whose outcome differs: hidden or with a false positive
  double mean_delta_logit = 0, mean_delta_score = 0;  ///< of |Δ|
};
template <class Visitor, class Key>
void visit_fields(Visitor& visit, const Compared<Key>& s) {
  visit_fields(visit, as_base<Success>(s));
  visit_fields(visit, s.key);
  if (s.difference) {
    visit({.name = "difference"}, *s.difference);
    visit.derived("told", to_word(classify(*s.difference)));
  }
  visit_named(visit, "flips", s.flips, "mean_delta_logit", s.mean_delta_logit, "mean_delta_score",
              s.mean_delta_score);
}

/// A set of vehicles found without the adversary.
struct VerdictGroup {
  int frames = 0, vehicles = 0;
  ClusterCount clusters;
  std::vector<VerdictVariant> variants;  ///< by kind, rungs in the ladder's order; none without vehicles
  std::vector<Compared<RenderCondition>> conditions;
  SuccessShares difference;                 ///< cycles − soft, paired
  double agree = 0;                         ///< share of the same outcome, soft and cycles
  std::optional<double> score_correlation;  ///< of the same two; none where one does not vary
  double score_mean_difference = 0;         ///< of |Δ|
};
template <class Visitor, FieldsOf<VerdictGroup> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "frames", s.frames, "vehicles", s.vehicles, "variants", s.variants, "arms", s.conditions,
              "difference", s.difference, "agree", s.agree, "score_correlation", s.score_correlation,
              "score_mean_difference", s.score_mean_difference);
  visit.derived("clusters", to_json(s.clusters));
  visit.derived("told", to_word(classify(s.difference.asr)));
}

/// The scores on a vehicle, found without the adversary or not; 0: no detection there.
struct ScorePair {
  std::string name, frame, split;  ///< split: "test" if it was held back, else "train"
  bool detected = false;
  double clean = 0, soft = 0, hard = 0, cycles = 0;
};
template <class Visitor, FieldsOf<ScorePair> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "name", .plain = true}, s.name);
  visit({.name = "frame", .plain = true}, s.frame);
  visit_named(visit, "split", s.split, "detected", s.detected, "clean", s.clean, "soft", s.soft, "hard",
              s.hard, "cycles", s.cycles);
}

/// A vehicle that is hidden under one of soft and cycles and found under the other.
struct VerdictFlip {
  std::string name, frame, split;  ///< as of a ScorePair
  double range = 0;                ///< m
  OutcomeResult soft, cycles;
  std::map<std::string, std::string> pictures;  ///< files, relative to OUT
};
template <class Visitor, FieldsOf<VerdictFlip> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "name", .plain = true}, s.name);
  visit({.name = "frame", .plain = true}, s.frame);
  visit_named(visit, "split", s.split, "range", s.range, "soft_iou", s.soft.iou, "soft_score", s.soft.score,
              "cycles_iou", s.cycles.iou, "cycles_score", s.cycles.score);
  visit.derived("from", s.soft.hidden ? "hidden" : "found");
  visit.derived("to", s.cycles.hidden ? "hidden" : "found");
  visit({.name = "pictures", .plain = true}, s.pictures);
}

struct Verdict {
  VerdictGroup held_back, all;
  std::vector<Compared<VerdictControl>> controls;  ///< over all vehicles
  std::vector<ScorePair> pairs;
  std::vector<VerdictFlip> flips;

  /// The group that the verdict is on: all vehicles if none was held back.
  const VerdictGroup& judged() const { return held_back.vehicles > 0 ? held_back : all; }
  /// Whether removing the object from that channel changes nothing: no outcome flips under any of the
  /// channel's controls, and the mean |Δlogit| stays below kMinDeltaLogit (detection/reliance.h) under each.
  /// Then the renderer of that channel says nothing about the attack. Empty without controls.
  std::optional<bool> vacuous(Channel channel) const;
  /// The condition nearest to reality: realistic returns, with Cycles' picture if the detector `sees`
  /// pictures, else the rasteriser's. Null without vehicles.
  const Compared<RenderCondition>* nearest_to_reality(bool sees) const;
};

/// `test_frames`: the frames whose vehicles are held back.
Verdict verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames);

/// {confidence, held_back, all, pairs, flips, of, arms, controls, vacuous}: the structs' fields by name, with
///   told: the verdict on a difference of asr (base/intervals.h); of: "held_back" or "all", the judged group,
///   whose arms stand here again; vacuous: {image, lidar, bound}.
nlohmann::json to_json(const Verdict& verdict);

/// Rasteriser and rays against the reference's, light for light (MatchedResult), over the vehicles: errors
/// over all their pixels, or the largest.
struct MatchedSummary : MatchedResult {
  double mask_iou_worst = 1;  ///< of a vehicle
};
template <class Visitor, FieldsOf<MatchedSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<MatchedResult>(s));
  visit_named(visit, "mask_iou_worst", s.mask_iou_worst, "pixels", s.mask_either);
}

/// The same of one camera of frames with several; without rays of the LiDAR.
struct CameraSummary {
  std::string camera;
  int vehicles = 0;  ///< that it sees
  MatchedSummary matched;
};

/// A target of matched light.
struct Target {
  std::string place;   ///< of the figure in result.json
  std::string camera;  ///< empty: all together
  double bound = 0;
  std::optional<bool> met;  ///< empty if nothing was measured: no pixel, no ray, no return
};
template <class Visitor, FieldsOf<Target> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "place", s.place, "target", s.bound, "met", s.met);
  if (!s.camera.empty()) visit({.name = "camera", .plain = true}, s.camera);
}

/// Means of a Change (ladders.h). `psnr`: of those that differ; empty if all are equal or not measured.
struct MeanChange {
  double mae = 0, relative = 0, ssim = 0, flip = 0;
  std::optional<double> psnr;
};
template <class Visitor, FieldsOf<MeanChange> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "mae", s.mae, "relative", s.relative, "ssim", s.ssim, "flip", s.flip);
  if (s.psnr) visit({.name = "psnr"}, *s.psnr);
}

/// The units that an interval is drawn over.
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
template <class Visitor, FieldsOf<PooledError> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "error_plain", s.plain, "floor", s.floor, "error_drawn", s.drawn, "error_unbiased",
              s.unbiased.value, "interval", s.unbiased, "interval_over", s.over);
}

/// The rasteriser's picture against full Cycles.
struct FullSummary {
  MeanChange change;
  double seconds = 0;                ///< of Cycles' picture
  std::optional<PooledError> error;  ///< none without vehicles
};
template <class Visitor, FieldsOf<FullSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.change);
  visit({.name = "seconds"}, s.seconds);
  visit.among("error_plain", s.error);
}

/// A rung over the vehicles that have it. The detector's figures are over vehicles found without the
/// adversary; `score_change` is the mean |Δ| from its score of the rasteriser's picture.
struct RungSummary {
  std::string effect;
  int vehicles = 0, detected = 0, hidden = 0, false_positive = 0;
  double fn_asr = 0, asr = 0, mean_score = 0, score_change = 0;
  double seconds = 0;
  std::optional<double> logit;  ///< mean; none where `detected` is 0
};
template <class Visitor, FieldsOf<RungSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "effect", s.effect, "vehicles", s.vehicles, "detected", s.detected, "hidden", s.hidden,
              "false_positive", s.false_positive, "fn_asr", s.fn_asr, "asr", s.asr, "mean_score",
              s.mean_score, "score_change", s.score_change, "seconds", s.seconds);
  if (s.logit) visit({.name = "logit"}, *s.logit);
}
/// A rung of the ladder of light (LightRungResult).
struct LightRungSummary : RungSummary {
  std::string group, base;
  MeanChange change, crop, to_full;
  PooledError error;
};
template <class Visitor, FieldsOf<LightRungSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<RungSummary>(s));
  visit_fields(visit, s.change);
  visit_fields(visit, s.error);
  visit_named(visit, "group", s.group, "base", s.base, "crop", s.crop, "to_full", s.to_full);
}
/// A rung of the LiDAR's ladder (LidarRungResult).
struct LidarRungSummary : RungSummary {
  double returns = 0, changed = 0, returns_change = 0;
};
template <class Visitor, FieldsOf<LidarRungSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<RungSummary>(s));
  visit_named(visit, "returns", s.returns, "changed", s.changed, "returns_change", s.returns_change);
}

/// How many vehicles the adversary fools, drawn by the rasteriser and by Cycles.
struct FooledSummary {
  int detected_clean = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0;
  int fooled_raster = 0, fooled_cycles = 0;
  /// `count` as a share of the vehicles found without the adversary, in [0, 1].
  double share(int count) const { return count / (detected_clean > 0 ? double(detected_clean) : 1); }
};
template <class Visitor, FieldsOf<FooledSummary> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "detected_clean", s.detected_clean, "hidden_raster", s.hidden_raster, "hidden_cycles",
              s.hidden_cycles, "hidden_both", s.hidden_both);
  visit.derived("fn_asr_raster", s.share(s.hidden_raster));
  visit.derived("fn_asr_cycles", s.share(s.hidden_cycles));
  visit.derived("asr_raster", s.share(s.fooled_raster));
  visit.derived("asr_cycles", s.share(s.fooled_cycles));
}

/// The summary of the vehicles on which the object is in view.
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

/// As result.json has it (src/README.md): the fields by name, `cameras` only if there are some.
nlohmann::json to_json(const ValidationSummary& summary);

}  // namespace mirage
