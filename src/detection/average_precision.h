// How good a detector is: which labels count, and average precision over them.
#pragma once

#include <span>
#include <vector>

#include "detection/detector.h"

namespace mirage {

/// The labels of one frame as detection sees them.
struct GroundTruth {
  std::vector<BevBox> boxes;        ///< must be found
  std::vector<BevBox> ignore;       ///< may be found: neither right nor wrong
  std::vector<std::size_t> labels;  ///< index into frame.labels of each of `boxes`
};

/// KITTI's "hard" cars that can be seen at all. A label must be found if it is a Car, truncated ≤ 0.5,
/// occluded ≤ 2, at least 25 pixels high in the image, with its centre inside `region` and at least 3 of
/// `points` in its box (grown by 0.1 m). Other cars and all vans are ignored: finding them is neither right
/// nor wrong. Everything else (trucks, trams, people) is background. `points` are those in view.
GroundTruth ground_truth(const Frame& frame, std::span<const LidarPoint> points,
                         const std::array<double, 4>& region);

/// One frame's detections after non-maximum suppression, and its labels.
struct ScoredFrame {
  std::vector<Proposal> detections;
  GroundTruth truth;
};

struct PrecisionRecall {
  double average_precision = 0;  ///< in [0, 1]
  double recall = 0;             ///< share of the boxes found by any detection
  int boxes = 0;
};

/// Detections of all frames are taken by falling score (ties: frame, then place in the frame). Each claims
/// the unclaimed box of its frame that it overlaps most, if that reaches `min_iou`: a hit. Otherwise it is
/// dropped when it overlaps an ignored box by `min_iou`, or covers one so that half of itself lies inside,
/// and is a false alarm when not. AP is the mean over recalls 1/40 … 40/40 of the best precision at that
/// recall or above (Simonelli et al., ICCV 2019; KITTI since 2019). Without boxes AP and recall are 0.
PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou);

}  // namespace mirage
