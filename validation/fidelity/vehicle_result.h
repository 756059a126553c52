// A validation's result for one vehicle, as it is stored (OUT/hosts/NAME.json) and as summary, verdict and
// budget read it.
#pragma once

#include <array>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/fields.h"
#include "frames/host_id.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/reference_renderer.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {

/// The detector's outcome at the vehicle for one picture and one sweep.
struct OutcomeResult {
  double iou = 0, score = 0;  ///< of the best box on it; 0: none
  double logit = 0;           ///< of the proposal that speaks for it (detection/reliance.h)
  bool hidden = false, false_positive = false;
  bool fooled() const { return hidden || false_positive; }
};
template <class Visitor, FieldsOf<OutcomeResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "iou", s.iou, "score", s.score, "logit", s.logit, "hidden", s.hidden, "false_positive",
              s.false_positive);
}

/// The renderer of the object under a condition, and its LiDAR returns (vehicle_validation.h).
enum class ConditionLight { learned, raster, visible, cycles };
constexpr auto words_of(ConditionLight) {
  return std::to_array<const char*>({"learned", "raster", "visible", "cycles"});
}
enum class ConditionReturns { learned, ideal, realistic };
constexpr auto words_of(ConditionReturns) {
  return std::to_array<const char*>({"learned", "ideal", "realistic"});
}
struct RenderCondition {
  ConditionLight light = ConditionLight::raster;
  ConditionReturns returns = ConditionReturns::ideal;
  bool operator==(const RenderCondition&) const = default;
};
template <class Visitor, FieldsOf<RenderCondition> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "light", s.light, "returns", s.returns);
}

/// The sensor whose view of the object a control takes away, and the replacement.
enum class Channel { image, lidar };
constexpr auto words_of(Channel) {
  return std::to_array<const char*>({"image", "lidar"});
}
struct VerdictControl {
  Channel channel = Channel::image;
  std::string control;
  bool operator==(const VerdictControl&) const = default;
};
template <class Visitor, FieldsOf<VerdictControl> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "channel", s.channel, "control", s.control);
}

/// The detector's outcome under a condition, and under a control.
struct ConditionResult {
  RenderCondition condition;
  OutcomeResult outcome;
};
template <class Visitor, FieldsOf<ConditionResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.condition);
  visit_fields(visit, s.outcome);
}
struct ControlResult {
  VerdictControl control;
  OutcomeResult outcome;
};
template <class Visitor, FieldsOf<ControlResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.control);
  visit_fields(visit, s.outcome);
}
/// {arms, controls} of vehicle_validation.h: empty for a vehicle that is not found without the adversary.
struct VerdictResults {
  std::vector<ConditionResult> conditions;
  std::vector<ControlResult> controls;
};
template <class Visitor, FieldsOf<VerdictResults> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "arms", s.conditions, "controls", s.controls);
}

/// Rasteriser and rays against the reference's, light for light (ladders.h).
struct MatchedResult {
  double mask_iou = 1, mae = 0, max_error = 0;  ///< errors over the union of the masks, scene-linear
  /// Depth error (m) at the pixels' centres against the reference's rays, largest and mean.
  double depth_error = 0, depth_error_mean = 0;
  int mask_both = 0, mask_either = 0;  ///< pixels
  /// Pixels that are off by more than 1e-3: their centre lies within float32 of a border between texels or
  /// faces.
  int pixels_off = 0;
  double range_error = 0;     ///< m, largest over rays that both hit
  int rays = 0, returns = 0;  ///< of the sensor model near the object; simulated on it
  int hit_disagreements = 0;  ///< rays that only one of the two sees hit the object
  /// Adds other pictures or rays.
  void add(const MatchedResult& other);
};
template <class Visitor, FieldsOf<MatchedResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "mask_iou", s.mask_iou, "mae", s.mae, "max_error", s.max_error, "depth_error_m",
              s.depth_error, "depth_error_mean_m", s.depth_error_mean, "mask_both", s.mask_both,
              "mask_either", s.mask_either, "pixels_off", s.pixels_off, "range_error_m", s.range_error,
              "rays", s.rays, "returns", s.returns, "hit_disagreements", s.hit_disagreements);
}

/// The rasteriser's picture against full Cycles.
struct FullResult {
  double mae = 0, mean = 0, ssim = 1, flip = 0;
  double noise = 0, seconds = 0;  ///< of Cycles' picture
  SquaredError error;
};
template <class Visitor, FieldsOf<FullResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "mae", s.mae, "mean", s.mean, "ssim", s.ssim, "flip", s.flip, "noise", s.noise,
              "seconds", s.seconds);
  if (s.mean > 0) visit.derived("relative", s.mae / s.mean);
  visit_fields(visit, s.error);
}

/// A rung of the ladder of light (ladders.h).
struct LightRungResult {
  std::string effect;
  std::string group;   ///< "raster": ours; "cycles": effects in Cycles; "samples": the full render with fewer
  std::string base;    ///< the rung (or "centres", "reference") that `change` is against
  Change change;       ///< over the object's visible pixels
  Change crop;         ///< over the whole window: the shadow that the object casts shows here
  Change to_full;      ///< error against the reference over the object's visible pixels, as a camera sees it
  SquaredError error;  ///< of the object alone, before anything saturates (unbiased_error.h, error_to)
  double seconds = 0;
  std::optional<OutcomeResult> outcome;  ///< of a vehicle that is found without the adversary
};
template <class Visitor, FieldsOf<LightRungResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "effect", s.effect, "group", s.group, "base", s.base);
  visit_fields(visit, s.change);
  visit_named(visit, "crop", s.crop, "to_full", s.to_full);
  visit_fields(visit, s.error);
  visit({.name = "seconds", .range = kNotNegative}, s.seconds);
  visit.among("score", s.outcome);
}
/// A rung of the LiDAR's ladder (ladders.h).
struct LidarRungResult {
  std::string effect;
  int returns = 0;            ///< on the object
  double changed = 0;         ///< of all returns, ideal or not: the share that is lost, moved or new
  double returns_change = 0;  ///< relative change of their number
  double seconds = 0;         ///< of the whole insertion
  std::optional<OutcomeResult> outcome;
};
template <class Visitor, FieldsOf<LidarRungResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "effect"}, s.effect);
  visit({.name = "returns", .range = kNotNegative}, s.returns);
  visit({.name = "changed", .range = kShare}, s.changed);
  visit({.name = "returns_change"}, s.returns_change);
  visit({.name = "seconds", .range = kNotNegative}, s.seconds);
  visit.among("score", s.outcome);
}
/// The full render that light is measured against (ladders.h).
struct ReferenceResult {
  int samples = 0;  ///< in both halves together
  double seconds = 0;
  double noise = 0;  ///< its own error, a share of the object's mean radiance (root mean square)
};
template <class Visitor, FieldsOf<ReferenceResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "samples", .range = kNotNegative}, s.samples);
  visit_named(visit, "seconds", s.seconds, "noise", s.noise);
}
/// The results of the ladders on one vehicle.
struct LadderResult {
  std::vector<LightRungResult> light;
  std::vector<LidarRungResult> lidar;
  ReferenceResult reference;
  std::map<std::string, double> features;  ///< scene_features() (ladders.h)
};
template <class Visitor, FieldsOf<LadderResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "ladder", s.light, "lidar_ladder", s.lidar, "reference", s.reference, "features",
              s.features);
}

/// One of several cameras that see the object, against the reference: `matched` without rays of the LiDAR.
struct CameraResult {
  std::string camera;
  MatchedResult matched;
  FullResult full;
};
template <class Visitor, FieldsOf<CameraResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "camera", s.camera, "matched", s.matched, "full", s.full);
}
/// The cameras of a frame with several that see the object: the one with its host's label first, else the one
/// that shows most of it. Figures of one picture (FullResult, ladders) are of that camera.
struct SurroundResult {
  std::vector<CameraResult> cameras;
};
template <class Visitor, FieldsOf<SurroundResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "cameras"}, s.cameras);
}

/// The vehicle without the adversary.
struct CleanResult {
  double iou = 0, score = 0;
};
template <class Visitor, FieldsOf<CleanResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "iou", .range = kNotNegative}, s.iou);
  visit({.name = "score", .range = kNotNegative}, s.score);
}

/// The results for a vehicle on which the object is in view.
struct SeenResult {
  MatchedResult matched;  ///< over all pixels of all cameras
  int samples = 0;
  FullResult full;
  std::optional<SurroundResult> surround;  ///< of a frame with several cameras
  double range = 0;                        ///< m
  bool detected = false;
  CleanResult clean;
  OutcomeResult raster, hard, cycles;
  std::optional<VerdictResults> conditions;
  std::optional<LadderResult> ladder;
  std::map<std::string, std::string> pictures;  ///< files, relative to OUT
};
template <class Visitor, FieldsOf<SeenResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "matched"}, s.matched);
  visit({.name = "samples", .range = kNotNegative}, s.samples);
  visit({.name = "full"}, s.full);
  visit({.name = "range", .range = kNotNegative}, s.range);
  visit_named(visit, "detected", s.detected, "clean", s.clean, "raster", s.raster, "hard", s.hard, "cycles",
              s.cycles);
  visit.among("cameras", s.surround);
  visit.among("arms", s.conditions);
  visit.among("ladder", s.ladder);
  visit({.name = "pictures", .plain = true}, s.pictures);
}

struct VehicleResult {
  HostId host;
  std::string name;  ///< host_name()
  bool from_box = false;
  double visible_share = 0;
  int adversary_points = 0;
  int victim = -1;  ///< the label that is judged in the host's place (HostOutcome::victim); −1: the host
  /// Identity in the data set of the judged vehicle; not stored, because the set may gain identities later.
  int track = -1;
  std::optional<SeenResult> seen;
  std::vector<ReferenceLoss> losses;
  /// Data that the report alone shows: bev, picture_boxes, host_rect, crop_rect.
  nlohmann::json shown = nlohmann::json::object();
};
/// All fields but the host and `shown`.
template <class Visitor, FieldsOf<VehicleResult> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "name", .plain = true}, s.name);
  visit({.name = "victim", .range = {-1, Range::kMax}, .lacking = "-1"}, s.victim);
  visit({.name = "from_box"}, s.from_box);
  visit({.name = "visible_share", .range = kNotNegative}, s.visible_share);
  visit({.name = "adversary_points", .range = kNotNegative}, s.adversary_points);
  visit.among("matched", s.seen);
  if (s.seen) visit({.name = "losses"}, s.losses);
}

/// The vehicle as it is stored.
nlohmann::json to_json(const VehicleResult& vehicle);
/// Reads JSON of to_json. InputError naming file and field if one is missing or of another type.
VehicleResult read_vehicle(const std::filesystem::path& file, const nlohmann::json& json);

}  // namespace mirage
