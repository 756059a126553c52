// How good a detector is: which labels count, and average precision over them.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "detection/detector.h"

namespace mirage {

/// KITTI's levels. Cars of a level: easy at least 40 pixels high, occluded 0, truncated ≤ 0.15; moderate at
/// least 25, ≤ 1, ≤ 0.3; hard at least 25, ≤ 2, ≤ 0.5. A harder level includes the easier ones.
enum class Difficulty { easy, moderate, hard };
/// Geiger et al., CVPR 2012; the benchmark's development kit.
struct DifficultyLimits {
  double least_height;  ///< pixels
  int most_occluded;
  double most_truncated;
};
/// The limits of a level.
const DifficultyLimits& limits_of(Difficulty difficulty);
/// The easiest level whose limits the label meets; hard if it meets none.
Difficulty easiest_level(const Label& label);

/// The label's box in the picture.
PictureBox picture_box(const Label& label);
/// The label's boxes; none in space unless has_box().
ObjectBoxes boxes_of(const Label& label);

/// A label that must be found.
struct TruthBox : ObjectBoxes {
  using ObjectBoxes::ObjectBoxes;
  /// A label of which only the boxes are known.
  TruthBox(const ObjectBoxes& boxes = {}) : ObjectBoxes(boxes) {}
  std::size_t label = 0;                     ///< index into frame.labels
  Difficulty difficulty = Difficulty::easy;  ///< its easiest_level
  double distance = 0;                       ///< m from the `velo` origin
  int track = -1;                            ///< Label::track
  /// In `label`: a vehicle that ground-truth sampling pasted.
  static constexpr std::size_t kPasted = std::numeric_limits<std::size_t>::max();
};

/// The labels of one frame as detection sees them.
struct TruthBoxes {
  std::vector<TruthBox> boxes;                ///< must be found
  std::vector<ObjectBoxes> ignore;            ///< may be found: neither right nor wrong
  std::vector<ObjectBoxes> look_alikes = {};  ///< of type "Misc": background that a LiDAR takes for cars
};

/// The labels in space, and those in the picture.
struct GroundTruth {
  TruthBoxes space, picture;
};

/// Whether a label must be found: a Car (or another that is_sought) of a level, with its centre inside
/// `region` (x and y from, to; `velo`, m). It may have no returns: its pixels can be enough.
bool counts_by_label(const Label& label, const std::array<double, 4>& region);

/// Sorts the labels by counts_by_label. Other cars and vans are ignored: finding them is neither right nor
/// wrong. Everything else (trucks, trams, people, the generator's look-alikes: "Misc") is background. In a
/// frame without labels (Frame::labelled) everything is ignored. In the picture: picture_truth() of the
/// cameras that a detector of these capabilities reads.
GroundTruth ground_truth(const Frame& frame, const std::array<double, 4>& region,
                         const Capabilities& can = {});

/// By a camera's number (Label::camera): its place in sensors() of the frame as recorded, −1 for a camera
/// that a detector of these capabilities does not read.
std::vector<int> places_of_cameras(const Frame& frame, const Capabilities& can);

/// Cars of a level must be found, whatever their distance and their returns. Other cars, vans, trucks, trams
/// and DontCare regions are ignored: networks for photographs know vehicles, not cars. `places`:
/// places_of_cameras(); labels in pictures of other cameras are left out. Empty: of the first camera alone.
TruthBoxes picture_truth(std::span<const Label> labels, std::span<const int> places = {});

/// One frame's detections after non-maximum suppression, and its labels.
struct ScoredFrame {
  std::vector<Detection> detections;
  TruthBoxes truth;
  double focal_length = 0;  ///< pixels (fy); 0: unknown
  Matching matching = {};   ///< how the detections are compared with the truth
};

/// The detections, with the truth that they are compared with.
ScoredFrame scored(std::vector<Detection> detections, const GroundTruth& truth, double focal_length,
                   Matching matching);

/// A precision-recall curve, and the area under it.
struct PrecisionRecall {
  double average_precision = 0;  ///< in [0, 1]
  double recall = 0;             ///< share of the boxes found by any detection
  int boxes = 0;
  /// (recall, precision) after each detection that counts, by falling score; precision is the best at that
  /// recall or above.
  std::vector<std::array<double, 2>> curve;
};

/// Detections of all frames are taken by falling score (ties: frame, then place in the frame). Each claims
/// the unclaimed box of its frame that it overlaps most (Matching), if that reaches `min_iou`: a hit.
/// Otherwise it is dropped if it overlaps an ignored box by `min_iou` or lies inside one by half of its own
/// area; if not, it is a false alarm. In the picture, as in KITTI's benchmark, it is also dropped below 25
/// pixels of height. AP is the mean over recalls 1/40 … 40/40 of the best precision at that recall or above
/// (Simonelli et al., ICCV 2019; KITTI since 2019). Without boxes AP and recall are 0.
PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou);

/// The same frames with look-alikes ignored instead of background: their detections no longer count.
std::vector<ScoredFrame> without_look_alikes(std::span<const ScoredFrame> frames);

/// average_precision's AP with its 95 % interval over clusters (base/intervals.h): a box and the hit on it go
/// with the vehicle if its identity is known, otherwise with the frame; false alarms go with their frame. The
/// whole of [0, 1] where a single cluster holds all boxes. {0, 0, 1} without boxes.
Interval average_precision_interval(std::span<const ScoredFrame> frames, double min_iou);

/// AP of `a` minus AP of `b`, with its 95 % interval: both look at the same frames with the same truth, and
/// their clusters are left out together (paired). {0, -1, 1} without boxes.
Interval average_precision_difference(std::span<const ScoredFrame> a, std::span<const ScoredFrame> b,
                                      double min_iou);

/// The clusters of these intervals: those that hold a box which must be found.
ClusterCount clusters_of(std::span<const ScoredFrame> frames);

/// The boxes whose centre is at a distance in [nearest, farthest) of the sensor, of a level or an easier one.
struct Stratum {
  std::string name;
  double nearest = 0, farthest = 1e9;  ///< m
  Difficulty hardest = Difficulty::hard;
};
/// "0-20 m", "20-40 m", "40-70 m", "0-40 m", "easy", "moderate", "hard".
std::vector<Stratum> standard_strata();

/// AP over a stratum. Boxes outside it are ignored, not missed. A detection that overlaps none of its boxes
/// by `min_iou` is dropped if it is itself outside: by its distance, or, as in KITTI's benchmark, by fewer
/// pixels of height in the image than the level's. A car is assumed to be 1.53 m high, KITTI's mean: its
/// distance ahead gives its height in the image, or its height in the picture its distance.
PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou,
                                  const Stratum& stratum);

}  // namespace mirage
