// Detections in frames as recorded: an attack succeeds only on a vehicle that was detected before.
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

/// Cache of detections in frames as recorded: in memory while the network's weights stay the same, and on
/// disk if the detector's identity is known. Thread-safe.
class CleanDetectionCache {
 public:
  CleanDetectionCache() = default;
  /// `identity`: detector_identity(); empty: nothing is kept on disk. `store` outlives this.
  CleanDetectionCache(FrameStore& store, std::string identity)
      : store_(&store), identity_(std::move(identity)) {}
  /// The frame's detections above the score threshold of an evaluation.
  std::vector<Detection> of(const PreparedFrame& prepared, Detector& detector);
  /// Down to the score threshold of AP (kScoreThresholdForAp); runs the detector once for each frame.
  std::vector<Detection> all_of(const PreparedFrame& prepared, Detector& detector);

 private:
  FrameStore* store_ = nullptr;
  std::string identity_;
  std::mutex mutex_;  // guards the members below
  std::uint64_t version_ = 0;
  std::map<std::string, std::vector<Detection>> frames_;
};

/// Whether any proposal finds the host at the score and the IoU of an evaluation (EvaluationSettings).
bool finds(std::span<const Detection> proposals, const HostTruth& truth);
/// The same by the rule "vanished" (kMissCriteria): any box on the host counts.
bool reports(std::span<const Detection> proposals, const HostTruth& truth);

/// A detector's proposals in one frame as recorded, and the vehicles that count there.
struct CleanFrame {
  std::vector<Detection> proposals;  ///< down to kScoreThresholdForAp, after suppression
  std::vector<HostTruth> hosts;
  ScoredFrame scored;
  int width = 0, height = 0;  ///< of the picture
};

/// How many vehicles a detector finds in frames as recorded.
struct CleanPerformance {
  int found = 0, vehicles = 0, frames = 0;
  bool of_objects = false;    ///< Victim::object: `found` counts plain objects, not vehicles
  double ap50 = 0, ap70 = 0;  ///< over the frames' vehicles, by Mirage's rules (average_precision.h)
  int boxes = 0;              ///< above an evaluation's score threshold, in all frames
  double best_score = 0;      ///< of any box; 0 without one
  /// Suspected mistakes in the boxes, the likeliest first, each with its measurement.
  std::vector<std::string> hints;
};

/// `hints` names suspected mistakes in the detector's boxes. If too few vehicles are found, each known
/// mistake (degrees, sides swapped, other axes, …) is undone in turn. The correction that finds most is named
/// with its count.
CleanPerformance clean_performance(const std::vector<CleanFrame>& frames, Matching matching);
/// Runs the detector on every frame of `hosts`. With Victim::object: tests whether a plain object
/// (plain_object()) is reported at some hosts, spread evenly; `clean_cache` is not used.
CleanPerformance measure_clean_performance(const DetectorPool& detectors, FrameStore& store,
                                           const std::vector<Host>& hosts,
                                           const SimulationSettings& simulation,
                                           CleanDetectionCache& clean_cache, bool quiet);

/// "finds 83 of 112 vehicles (AP 0.7 59.0 %)", "reports a plain object at 31 of 48 places"
std::string describe(const CleanPerformance& found);
/// {found, vehicles, frames, ap50, ap70, hints}
nlohmann::json to_json(const CleanPerformance& found);

/// A smaller share of found vehicles causes a warning: rates over so few vehicles mean nothing.
inline constexpr double kFewFound = 0.1;
/// InputError naming the detector, with the hints, if it finds no vehicle. Warns if it finds few, or if its
/// logits look like probabilities.
void require_detections(const CleanPerformance& found, const Detector& detector);

}  // namespace mirage
