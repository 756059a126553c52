// Whether a detector uses its picture: the gate before every statement about images.
//
// The same frames are looked at four times, with the sweep as it is: with the right picture; with that of
// another frame of the same size; with a black one; and with none, where the detector can do without. A
// detector that sees loses average precision over the wrong picture, and its cars' logits move. One that does
// not may still score well (a LiDAR network finds the cars by itself), and then an attack through its image,
// a defence of it, or the light on an object are experiments on something that it ignores.
//
// A car's logit in a pass is the largest of the proposals that overlap its box (IoU ≥ 0.1, before
// suppression) and have a score over 1e-4; without one it is that score's, −9.2. So a car that is lost under
// the wrong picture counts with what it lost, and a proposal that has moved a little is still the same car's.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/clusters.h"
#include "base/intervals.h"
#include "base/json_fields.h"
#include "detection/detect.h"
#include "detection/detector.h"

namespace mirage {

/// Below this mean |Δlogit| of the cars a detector counts as blind, whatever its AP does.
inline constexpr double kLeastDeltaLogit = 0.5;

/// The proposal that speaks for a car: of those that overlap its rectangle in `plane` (IoU ≥ 0.1), before
/// suppression, the one of the largest logit; without one over kFaintScore, a proposal of that score.
Proposal speaker(std::span<const Proposal> proposals, const BevBox& car, Plane plane);

/// Shares in [0, 1]; AP in the detector's plane at IoU 0.7 over cars as in average_precision.h.
struct Reliance {
  bool reads_picture = true;  ///< false: a detector without a camera, of which the rest was not measured
  double ap70 = 0, ap70_swapped = 0, ap70_black = 0;
  std::optional<double> ap70_none;  ///< without any picture, where the detector can
  /// ap70 − ap70_swapped with its 95 % interval (average_precision_difference: paired, by cluster).
  Interval drop;
  double mean_delta_logit = 0;  ///< over the cars: mean |logit(right) − logit(swapped)|
  double delta_logit_high = 0;  ///< upper end of its 95 % interval; infinite where it cannot be known
  double mean_delta_score = 0;  ///< the same of the scores
  int frames = 0;               ///< looked at
  int left_out = 0;             ///< no other frame has a picture of their size
  int vehicles = 0;             ///< labelled cars that must be found, in `frames`
  ClusterCount clusters;        ///< of these

  /// The gate: the wrong picture costs AP beyond the interval, and the cars' logits move by kLeastDeltaLogit.
  bool uses_picture() const { return reads_picture && drop.low > 0 && mean_delta_logit >= kLeastDeltaLogit; }
  /// Its contrary, which few frames cannot tell: that AP falls by less than kSameWithin, or that the logits
  /// move by less than kLeastDeltaLogit, is beyond the interval too.
  bool ignores_picture() const {
    return reads_picture && vehicles > 0 && drop.value < kSameWithin &&
           (drop.high < kSameWithin || delta_logit_high < kLeastDeltaLogit);
  }
};

/// Whether the picture can reach its answers at all.
bool reads_picture(const Detector& detector);

/// What is to be said of a detector without a camera.
Reliance no_camera();

/// A frame, and the one whose picture it is shown.
struct PicturePair {
  std::string frame, other;
};
/// The frames by their pictures' size; each gets the picture of the one half a round further among those of
/// its size (neighbours of a drive look alike). Frames that are alone with their size are left out. In the
/// order of `ids`. InputError for a missing picture.
std::vector<PicturePair> pair_pictures(const std::filesystem::path& data,
                                       const std::vector<std::string>& ids);

/// The measurement frame by frame, for who looks at the frames anyway.
class RelianceMeter {
 public:
  struct Looks;
  /// Of those frames of the data set. Errors of pair_pictures.
  RelianceMeter(std::filesystem::path data, const std::vector<std::string>& ids);
  ~RelianceMeter();
  /// Those that are measured.
  const std::vector<PicturePair>& pairs() const { return pairs_; }
  /// Shows the detector, which has a camera, one of them under the other pictures. `points`: in view;
  /// `right`: what it proposes under the frame's own picture over kFaintScore, before suppression. Nothing
  /// happens with a frame that has no pair. Several frames may be looked at side by side.
  void look(Detector& detector, const Frame& frame, std::span<const LidarPoint> points,
            const std::vector<Proposal>& right);
  /// Over the frames that were looked at.
  Reliance result() const;

 private:
  std::filesystem::path data_;
  std::vector<PicturePair> pairs_;
  std::size_t frames_;
  std::vector<std::unique_ptr<Looks>> looks_;  ///< of each of pairs_
};

/// Looks at those frames of the data set. `detectors`: instances of one detector, at least one; each works on
/// a thread of its own. `progress(done, total)` may be empty. For a detector without a camera nothing is run.
/// Errors of read_frame and of the detector; Interrupted between frames.
Reliance measure_reliance(std::span<Detector* const> detectors, const std::filesystem::path& data,
                          const std::vector<std::string>& ids,
                          const std::function<void(std::size_t, std::size_t)>& progress = {});

/// What stands in place of every statement about images; empty if the detector uses its picture.
std::string picture_note(const Reliance& reliance);
/// The measurement in words: "AP 0.7 76.8 % with the right picture, 70.1 % with another frame's: …".
std::string describe(const Reliance& reliance);

/// {reads_picture, uses_picture, note, ap70, ap70_swapped, ap70_black, ap70_none?, drop, drop_low, drop_high,
/// mean_delta_logit, delta_logit_high?, mean_delta_score, frames, frames_left_out, vehicles, clusters};
/// without a camera the first three alone.
nlohmann::json to_json(const Reliance& reliance);
/// Its inverse. InputError, naming file and field, for anything else.
Reliance reliance_from_json(const JsonFields& fields);

}  // namespace mirage
