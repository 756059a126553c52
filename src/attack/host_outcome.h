// What a detector says of one host, clean and attacked (attack/evaluation.h has the definitions of success).
#pragma once

#include <limits>
#include <string>
#include <vector>

#include "base/clusters.h"
#include "detection/detector.h"
#include "frames/host_id.h"

namespace mirage {

/// A false positive: a detection that the adversary made.
struct NewBox {
  ObjectBoxes box;
  double score = 0;
  double distance = 0;  ///< m (in the picture: pixels), from the host's centre to the box's
  double range = 0;     ///< m, from the `velo` origin; 0 in the picture
};

/// What the detector says about one host, clean and attacked.
struct HostOutcome {
  HostId id;
  int mesh = 0;                                ///< which of the judged meshes
  int track = -1;                              ///< the label's
  bool from_box = true;                        ///< the roof's pose is the labelled box's (Carrier)
  double range = 0;                            ///< m, host's box centre from the `velo` origin
  int occluded = 0;                            ///< the label's
  double truncated = 0;                        ///< the label's
  std::string kind;                            ///< EvaluationSettings::kinds
  Matching matching = {};                      ///< how the detector was judged
  double clean_iou = 0, attacked_iou = 0;      ///< best IoU of a detection with the host's box
  double clean_score = 0, attacked_score = 0;  ///< score of that detection
  /// m, from the host's centre to that of the nearest detection; infinite without any and in the picture.
  double clean_distance = std::numeric_limits<double>::infinity(),
         attacked_distance = std::numeric_limits<double>::infinity();
  bool detected = false, hidden = false, false_positive = false;
  double false_positive_distance = 0;      ///< from the host to the farthest new box, if any (NewBox)
  std::vector<NewBox> new_boxes;           ///< in the order of `attacked`
  std::vector<Detection> clean, attacked;  ///< detections after suppression

  /// What it is counted with (base/clusters.h).
  std::string cluster() const { return cluster_of(id.frame, track); }
  /// Whether the attack worked on this host, in either way: what ASR counts.
  bool fooled() const { return hidden || false_positive; }
};

}  // namespace mirage
