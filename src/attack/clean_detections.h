// What a detector finds in frames as recorded: an attack succeeds only where there was a detection before.
#pragma once

#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "attack/detector_pool.h"
#include "attack/host_outcome.h"
#include "detection/average_precision.h"
#include "frames/hosts.h"

namespace mirage {

/// Detections of frames as recorded, kept in memory as long as the network's weights are the same, and on
/// disk where it is told what detector they are of. Several threads may ask.
class CleanDetectionCache {
 public:
  CleanDetectionCache() = default;
  /// `identity`: detector_identity(); empty: nothing is kept on disk. `store` outlives this.
  CleanDetectionCache(FrameStore& store, std::string identity)
      : store_(&store), identity_(std::move(identity)) {}
  /// The frame's detections at the score of an evaluation.
  std::vector<Detection> of(const PreparedFrame& prepared, Detector& detector);
  /// Down to the score that AP looks at (kScoreThresholdForAp); the detector is asked once for each frame.
  std::vector<Detection> all_of(const PreparedFrame& prepared, Detector& detector);

 private:
  FrameStore* store_ = nullptr;
  std::string identity_;
  std::mutex mutex_;  // of what follows
  std::uint64_t version_ = 0;
  std::map<std::string, std::vector<Detection>> frames_;
};

/// Whether any of them finds the host at the score and the IoU of an evaluation (EvaluationSettings).
bool finds(std::span<const Detection> proposals, const HostTruth& truth);
/// The same of any box that stands there: by the rule "vanished" (kMissCriteria).
bool reports(std::span<const Detection> proposals, const HostTruth& truth);

/// What a detector says of one frame as recorded, and the vehicles there that count.
struct CleanFrame {
  std::vector<Detection> proposals;  ///< down to kScoreThresholdForAp, after suppression
  std::vector<HostTruth> hosts;
  ScoredFrame scored;
  int width = 0, height = 0;  ///< of the picture
};

/// How many of the vehicles a detector finds as recorded.
struct CleanPerformance {
  int found = 0, vehicles = 0, frames = 0;
  bool of_objects = false;    ///< Victim::object: not vehicles, but plain objects where one is to stand
  double ap50 = 0, ap70 = 0;  ///< over the frames' vehicles, by Mirage's rules (average_precision.h)
  int boxes = 0;              ///< over the score of an evaluation, in all frames
  double best_score = 0;      ///< of any box; 0 without one
  /// What the boxes look like instead, the likeliest first: each a measured fact.
  std::vector<std::string> hints;
};

/// `hints` names suspected mistakes in the detector's boxes. With too few vehicles found, each known mistake
/// (degrees, sides swapped, other axes, …) is undone in turn. Those whose undoing finds more are named with
/// their counts.
CleanPerformance clean_performance(const std::vector<CleanFrame>& frames, Matching matching);
/// Looks at every frame of `hosts`. With Victim::object: whether a plain object (plain_object()) is reported
/// at some of them, spread evenly; `clean_cache` is not used.
CleanPerformance measure_clean_performance(const DetectorPool& detectors, FrameStore& store,
                                           const std::vector<Host>& hosts,
                                           const SimulationSettings& simulation,
                                           CleanDetectionCache& clean_cache, bool quiet);

/// "finds 83 of 112 vehicles (AP 0.7 59.0 %)", "reports a plain object at 31 of 48 places"
std::string describe(const CleanPerformance& found);
/// {found, vehicles, frames, ap50, ap70, hints}
nlohmann::json to_json(const CleanPerformance& found);

/// Fewer than this share found: a warning. Of rates over so few vehicles nothing follows.
inline constexpr double kFewFound = 0.1;
/// InputError naming the detector, with the hints, if it finds no vehicle; a warning where it finds few, or
/// where its logits look like none.
void require_detections(const CleanPerformance& found, const Detector& detector);

}  // namespace mirage
