// How often an adversary fools a detector.
//
// For each host vehicle, with the detector run on the frame as recorded (clean) and with the adversary on the
// host's roof (attacked), after non-maximum suppression and at score ≥ score_threshold:
//   FN: the host is detected at IoU > 0.7 clean and not attacked.
//   FP: an attacked box that has IoU < 0.3 with every ground truth and no overlap with any clean detection.
// FN ASR, FP ASR and ASR (FN or FP) are shares of the vehicles that were detected clean
// (Tu et al., CoRL 2021, section 4). Recall–IoU runs over all hosts.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "attack/detector_pool.h"
#include "attack/hosts.h"
#include "base/bootstrap.h"

namespace mirage {

struct EvaluationSettings {
  double score_threshold = 0.3;
  double detected_iou = 0.7;
  double false_positive_iou = 0.3;
  bool quiet = false;
};

/// What the detector says about one host, clean and attacked.
struct HostOutcome {
  HostId id;
  bool from_box = true;                        ///< the roof's pose is the labelled box's (Rooftop)
  double range = 0;                            ///< m, host's box centre from the `velo` origin
  double clean_iou = 0, attacked_iou = 0;      ///< best IoU of a detection with the host's box
  double clean_score = 0, attacked_score = 0;  ///< score of that detection
  bool detected = false, hidden = false, false_positive = false;
  double false_positive_distance = 0;     ///< m from the host to the farthest new box, if any
  std::vector<Proposal> clean, attacked;  ///< detections after suppression
};

struct Evaluation {
  std::vector<HostOutcome> hosts;
  int vehicles = 0;  ///< hosts detected clean: the denominator
  double fn_asr = 0, fp_asr = 0, asr = 0;
  Interval fn_interval, fp_interval, asr_interval;  ///< 95 %, bootstrap over frames
  std::vector<double> iou, recall_clean, recall_attacked;
  RooftopCount rooftops;  ///< of all hosts
};

/// Detections of one view: proposals over the threshold after suppression.
std::vector<Proposal> detections(Detector& detector, const SensorView& view,
                                 const EvaluationSettings& settings);

/// Judges one host, given its clean and attacked detections.
HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Proposal> clean,
                  std::vector<Proposal> attacked, const EvaluationSettings& settings);

/// Shares and curves over outcomes.
Evaluation summarize(std::vector<HostOutcome> hosts);

/// Runs the detector on every host, clean and with the adversary.
Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings);

nlohmann::json to_json(const Evaluation& evaluation);

}  // namespace mirage
