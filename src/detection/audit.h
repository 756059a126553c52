// How much a detector's answers depend on each of its inputs, and on the calibration between them.
//
// The same frames are shown to the detector again and again, each time with one input changed: another
// frame's picture or a black one, another frame's sweep or a few of its beams, a camera that is turned
// against its calibration, a late picture. The cost of a change is the drop of AP at IoU 0.7, the shift of
// the cars' logits, and the cars that are no longer found. The right input is the control of every row, on
// the same frames and vehicles.
//
// A car's logit in a pass is the largest of the proposals that overlap its box (IoU ≥ 0.1, before
// suppression) and have a score over kFaintScore; without one it is that score's. So a lost car counts with
// its whole drop, and a proposal that has moved a little still belongs to its car.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "detection/average_precision.h"
#include "detection/detect.h"
#include "detection/detector.h"
#include "scene/data/data_set.h"

namespace mirage {

/// Below this mean |Δlogit| of the cars a detector does not use an input, whatever its AP does.
inline constexpr double kMinDeltaLogit = 0.5;

/// The inputs of a detector; calibration: the camera's pose against the other sensors.
enum class AuditInput { picture, points, calibration };
constexpr auto words_of(AuditInput) {
  return std::to_array<const char*>({"picture", "points", "calibration"});
}

/// The input that the detector gets in place of the right one.
struct AuditChange {
  /// Which input is wrong, and how: pictures first, then points, then the calibration.
  enum class Kind {
    other_picture,  ///< that of PicturePair::other
    black_picture,
    no_picture,
    blurred_picture,  ///< by a Gaussian of standard deviation `amount`, pixels, in linear light
    late_picture,     ///< the picture of the frame `amount` frames earlier in its sequence
    other_sweep,      ///< the points in view of PicturePair::other
    thinned_sweep,    ///< `amount` of the beams that have returns in view, drawn anew for each frame
    no_points,
    turned_camera,  ///< about the camera's vertical axis, by `amount` degrees
    moved_camera,   ///< to the left, by `amount` m
  };
  Kind kind;
  double amount = 0;

  /// The changed input.
  AuditInput input() const;
  /// no_picture, no_points: a detector may refuse to run without the input.
  bool removes_input() const;
  /// "another frame's", "blurred, 4 px", "turned 2°"
  std::string text() const;
};

/// All changes of inputs that the detector has, strongest last within a kind: pictures blurred by 2 and 8 px
/// and late by 1, 2 and 5 frames, 8, 4 and 2 beams, a camera turned by 0.5 to 10° and moved by 5 to 50 cm.
std::vector<AuditChange> audit_changes(const Capabilities& can);
/// The gate's changes (reliance.h): another frame's picture, a black one, none.
std::vector<AuditChange> gate_changes();

/// The default limit of the number of frames.
inline constexpr std::size_t kAuditFrames = 120;
/// `most` of the items (ids of frames, hosts), spread evenly; all if there are no more, or for 0.
template <class T>
std::vector<T> spread_evenly(const std::vector<T>& items, std::size_t most) {
  if (most == 0 || items.size() <= most) return items;
  std::vector<T> result;
  for (std::size_t i = 0; i < most; ++i) result.push_back(items[i * items.size() / most]);
  return result;
}

/// A frame, and another one whose picture or sweep replaces its own.
struct PicturePair {
  std::string frame, other;
};
/// Pairs each frame with the one half a round further among the frames of its picture's size (neighbours of a
/// drive look alike). Frames with a unique size are left out. In the order of `ids`. InputError for a missing
/// picture.
std::vector<PicturePair> pair_pictures(const std::filesystem::path& data,
                                       const std::vector<std::string>& ids);

/// Of the proposals that overlap the car by 0.1 or more, before suppression, the one of the largest logit;
/// without one over kFaintScore, a proposal of that score.
Detection matching_proposal(std::span<const Detection> proposals, const ObjectBoxes& car, Matching matching);

/// Whether an input is used, by the effect of its changes; `unclear`: too few frames to tell.
enum class InputUse { used, ignored, unclear };
/// The rule of the gate. Used: the wrong input costs AP 0.7 beyond the interval (`drop`), and the cars'
/// logits move by kMinDeltaLogit on average. Ignored: AP falls by less than kSameWithin, and the upper end of
/// its interval is below kSameWithin or that of the logits' below kMinDeltaLogit.
InputUse input_use(const Interval& drop, const Interval& delta_logit, int vehicles);

/// The cost of one change, over the frames that have it.
struct AuditRow {
  AuditChange change;
  std::string refused;  ///< the detector's error instead of an answer; all fields below are then 0
  int frames = 0, vehicles = 0;
  double right70 = 0, ap70 = 0;  ///< AP at IoU 0.7 with the right input and with this one, in [0, 1]
  Interval drop;                 ///< right70 − ap70, paired, by cluster
  Interval delta_logit;          ///< mean |logit(right) − logit(changed)| of the cars
  double delta_score = 0;        ///< the same of the scores
  /// Share of a stratum's cars found with the right input, minus the share found with this one. Found: a
  /// detection at IoU 0.7 with a score over kScoreThreshold.
  struct RecallLoss {
    std::string stratum;
    int vehicles = 0;
    Interval share;
  };
  std::vector<RecallLoss> lost;  ///< "all", "0-20 m", "20-40 m", "40-70 m"

  /// input_use of this change.
  InputUse use() const { return input_use(drop, delta_logit, vehicles); }
};

/// One detector on the frames of one data set, with each change.
struct Audit {
  int frames = 0;    ///< shown
  int left_out = 0;  ///< no other frame has a picture of their size
  int vehicles = 0;  ///< labelled cars that must be found
  ClusterCount clusters;
  double ap70 = 0;  ///< with the right inputs
  std::vector<AuditRow> rows;
  /// By frame: its detections with the right inputs, as detect_vehicles has them at kScoreThresholdForAp.
  std::map<std::string, std::vector<Detection>> as_recorded;

  /// Null if the change was not asked for.
  const AuditRow* row(AuditChange::Kind kind) const;
};

/// Runs the detector on those frames, each with every change that it has. `detectors`: instances of one
/// detector, at least one; each works on a thread of its own. `lidar`: the unit of the sweeps, for
/// thinned_sweep, which is left out without it. `seed` draws the beams. `progress(done, total)` may be empty.
/// A changed picture is that of every camera that the detector reads; a changed calibration is the first's. A
/// change that removes an input is `refused` if the detector fails on any frame without it. Its other errors
/// are passed on, as are read_frame's; Interrupted between frames. A call of all ranks (base/ranks.h), which
/// share the frames through RecordedFrames::cached_views; all but the first get nothing.
Audit run_audit(std::span<Detector* const> detectors, const RecordedFrames& source,
                const std::vector<std::string>& ids, const std::vector<AuditChange>& changes,
                const std::optional<LidarModel>& lidar = {}, std::uint64_t seed = 0,
                const std::function<void(std::size_t, std::size_t)>& progress = {});

/// The answer in sentences, one for each input that the detector has: "Another frame's picture costs 38.2
/// points of AP 0.7 (23.9 to 52.5): it uses its picture."
std::vector<std::string> describe(const Audit& audit);

/// {frames, frames_left_out, vehicles, clusters, intervals_over, ap70, answer: [text], uses: {image?,
/// points?: true, false or null where unclear}, audit: [{input, change, frames, vehicles, ap70_right, ap70,
/// drop, low, high, delta_logit, delta_logit_high?, delta_score, recall_lost: [{stratum, vehicles, value,
/// low, high}]} or {input, change, refused}]}
nlohmann::json to_json(const Audit& audit);

}  // namespace mirage
