// Whether a detector uses its picture: the gate before every statement about images.
//
// It is the audit (audit.h) of one input: another frame's picture, a black one and none. A detector that uses
// its picture loses average precision with a wrong one, and its cars' logits move. One that does not may
// still score well (a LiDAR network finds the cars by itself). Then an attack through its image, a defence of
// it, or the light on an object are experiments on an ignored input.
#pragma once

#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/json_fields.h"
#include "detection/audit.h"

namespace mirage {

/// Shares in [0, 1]; AP in the detector's plane at IoU 0.7 over cars as in average_precision.h.
struct Reliance {
  bool reads_picture = true;  ///< false: no camera, and the fields below are not measured
  double ap70 = 0, ap70_swapped = 0, ap70_black = 0;
  std::optional<double> ap70_none;  ///< without any picture, if the detector accepts that
  /// ap70 − ap70_swapped with its 95 % interval (average_precision_difference: paired, by cluster).
  Interval drop;
  double mean_delta_logit = 0;  ///< over the cars: mean |logit(right) − logit(swapped)|
  double delta_logit_high = 0;  ///< upper end of its 95 % interval; infinite if unknown
  double mean_delta_score = 0;  ///< the same of the scores
  int frames = 0;               ///< looked at
  int left_out = 0;             ///< no other frame has a picture of their size
  int vehicles = 0;             ///< labelled cars that must be found, in `frames`
  ClusterCount clusters;        ///< of these

  /// By the rule of input_use.
  InputUse use() const { return input_use(drop, {mean_delta_logit, 0, delta_logit_high}, vehicles); }
  /// Whether the picture is an input of the detector, and used.
  bool uses_picture() const { return reads_picture && use() == InputUse::used; }
  /// Whether the picture is an input, and ignored; few frames cannot show this.
  bool ignores_picture() const { return reads_picture && use() == InputUse::ignored; }
};

/// The result for a detector without a camera.
Reliance no_camera();

/// The gate's result from an audit that has gate_changes().
Reliance reliance_of(const Audit& audit);

/// run_audit with the gate's changes alone. For a detector without a camera nothing is run. `seen`, if given,
/// gets Audit::as_recorded.
Reliance measure_reliance(std::span<Detector* const> detectors, const RecordedFrames& source,
                          const std::vector<std::string>& ids,
                          const std::function<void(std::size_t, std::size_t)>& progress = {},
                          std::map<std::string, std::vector<Detection>>* seen = nullptr);

/// The text that replaces every statement about images; empty if the detector uses its picture.
std::string picture_note(const Reliance& reliance);
/// The measurement in words: "AP 0.7 76.8 % with the right picture, 70.1 % with another frame's: …".
std::string describe(const Reliance& reliance);

/// {reads_picture, uses_picture, note, ap70, ap70_swapped, ap70_black, ap70_none?, drop, drop_low, drop_high,
/// mean_delta_logit, delta_logit_high?, mean_delta_score, frames, frames_left_out, vehicles, clusters};
/// without a camera the first three alone.
nlohmann::json to_json(const Reliance& reliance);
/// The inverse of to_json. InputError naming file and field for invalid content.
Reliance reliance_from_json(const JsonFields& fields);

}  // namespace mirage
