// Attack success by strata of the host vehicles: range, occlusion, truncation, kind.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/detector_pool.h"
#include "attack/eot.h"
#include "attack/host_outcome.h"
#include "attack/observation.h"
#include "base/intervals.h"
#include "base/json_fields.h"
#include "frames/hosts.h"

namespace mirage {

/// One stratum of the hosts.
struct HostPart {
  std::string by, name;
  OutcomeTest holds;
};
/// Range: 0-15, 15-30, 30-50, 50+ m (includes the nearer end). Occlusion: KITTI's four levels. Truncation: up
/// to 0.15 (KITTI's "easy") and more. Kind: HostOutcome::kind, in alphabetical order.
std::vector<HostPart> host_parts(std::span<const HostOutcome> hosts);

/// Success in one of host_parts, which may have no hosts.
struct StratumSuccess {
  std::string by;    ///< "range", "occlusion", "truncation" or "kind"
  std::string name;  ///< "15-30 m", "partly occluded", …
  int hosts = 0;     ///< of one mesh
  SuccessRates rates;
  /// Share of all hosts with any box on them (the rule "vanished"), clean and attacked.
  struct Seen {
    Interval clean, attacked;
  };
  Seen seen;  ///< see Seen
};
template <class Visitor, FieldsOf<StratumSuccess::Seen> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "clean", s.clean, "attacked", s.attacked);
}
template <class Visitor, FieldsOf<StratumSuccess> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "by"}, s.by);
  visit({.name = "name", .plain = true}, s.name);
  visit({.name = "hosts"}, s.hosts);
  visit_fields(visit, s.rates);
  visit({.name = "seen"}, s.seen);
}

/// The kind of each host by host_name, if the data set knows it: a generated set rebuilds its streets and
/// gives body styles ("hatchback", …). Empty for recorded sets and sets of other generator versions, whose
/// hosts are all of type "Car".
std::map<std::string, std::string> vehicle_kinds(const std::filesystem::path& data,
                                                 const std::vector<HostId>& hosts);

// How often an adversary fools a detector.
//
// For each host vehicle the detector runs on the frame as recorded (clean) and with the adversary on the roof
// (attacked). Detections count after non-maximum suppression, at score ≥ score_threshold:
//   FN: the host is detected at IoU > 0.7 clean and not attacked.
//   FP: an attacked box that has IoU < 0.3 with every ground truth and no overlap with any clean detection.
// If the victim is the object itself (Victim::object), it is judged in the host's place, by its own_label().
// "Clean" is then the frame with a plain cuboid that fills the placement's volume, judged by the cuboid's
// label. A detector that finds boxes in the picture alone is judged there. Under attack a box around host and
// object also counts as a detection (HostTruth), and DontCare regions are ground truth. FN ASR, FP ASR and
// ASR (FN or FP) are shares of the vehicles that were detected clean (Tu et al., CoRL 2021, section 4);
// attack/host_outcome.h has misses by other rules. The recall–IoU curve covers all hosts. Several meshes are
// judged together: shares are means over meshes × hosts. The intervals' clusters stay those of one mesh:
// vehicles if the data set knows them, otherwise frames (base/intervals.h).

/// Thresholds for found vehicles and new boxes, and other settings of an evaluation.
struct EvaluationSettings {
  double score_threshold = 0.3;
  double detected_iou = 0.7;
  double false_positive_iou = 0.3;
  /// Random variation between vehicles: all meshes on a vehicle get the same draw. Detections without an
  /// object are those of the frames as recorded.
  EotSettings expectation = {};
  std::uint64_t expectation_seed = 0;
  /// How the detector is judged (Capabilities::matching); evaluate() sets it.
  Matching matching = {};
  bool quiet = false;
  /// False on a rank that reports nothing: evaluate() only fills the disk cache, returns no outcomes, and
  /// opens no frame of other ranks.
  bool reports_outcomes = true;
  /// detector_identity() of the pool's options (frames/frame_provenance.h); empty: clean detections are not
  /// cached.
  std::string detector_identity = {};
  /// Kind of vehicle by host_name; the label's type for hosts that are missing here.
  std::map<std::string, std::string> kinds = {};
};

/// Outcomes, the rates over them, and their intervals.
struct Evaluation {
  std::vector<HostOutcome> hosts;  ///< meshes × hosts, a mesh after the other
  /// The same, judged against the boxes grown by the object; empty if it grows none (TrueBox).
  std::vector<HostOutcome> against_grown;
  int meshes = 1;
  SuccessRates rates;                                   ///< of the hosts detected clean
  SuccessRates at50;                                    ///< of those detected clean at an IoU of 0.5
  MissRates hiding;                                     ///< misses by every rule
  std::vector<double> iou;                              ///< 0 … 1
  std::vector<Interval> recall_clean, recall_attacked;  ///< of all hosts, at each of `iou`
  std::vector<StratumSuccess> strata;
  RoofCount rooftops;     ///< of all hosts
  ClusterCount clusters;  ///< of the hosts detected clean
};

/// Whether detections are cached on disk; if so, a second run resumes, and ranks share their work.
bool is_cached_on_disk(FrameStore& store, const EvaluationSettings& settings);
/// How to resume, for the message of Interrupted.
const char* how_to_go_on(FrameStore& store, const EvaluationSettings& settings);
/// content_hash of every coordinate, index and texel.
std::string hash_of(const TexturedMesh& textured);

/// Number of the world's draw that all objects on this vehicle share.
std::uint64_t draw_of(const HostId& vehicle);

/// An object on a host as an evaluation shows it to a detector: in the vehicle's draw of
/// EvaluationSettings::expectation, or as recorded if nothing is drawn. Its arguments must outlive it.
class JudgedScene {
 public:
  /// Draws and simulates. Errors as FrameStore::placement.
  JudgedScene(FrameStore& store, const HostId& id, const TexturedMesh& mesh,
              const SimulationSettings& simulation, const EvaluationSettings& settings);
  JudgedScene(const JudgedScene&) = delete;
  JudgedScene& operator=(const JudgedScene&) = delete;

  /// The sensors' view with the object.
  Observation& observation() { return observation_; }
  /// The frame as recorded, without the object.
  const PreparedFrame& recorded() const { return *recorded_; }

 private:
  std::shared_ptr<const PreparedFrame> recorded_;
  SampledEnvironment draw_;
  StepHost host_;
  Observation observation_;
};

/// Detections of one view: proposals over the threshold after suppression.
std::vector<Detection> detections(Detector& detector, const SensorView& view,
                                  const EvaluationSettings& settings);

/// Changes to a host's ground truth that a placement causes.
struct EvaluationLabels {
  /// carried_box() of the object in the attacked picture; needed only with Matching::in_picture.
  std::optional<PictureBox> object = {};
  std::optional<int> victim = {};  ///< Placement::neighbour: its label is judged
  /// grown_box(): the true box in the attacked frame. nullopt: the label's box.
  std::optional<Box3> grown = {};
  /// Victim::object: own_label() of the judged object, and of the plain object in the clean frame.
  std::optional<Label> own = {}, plain = {};
};
/// For an object as placed (`velo`) with carried_box() `object`, judged against labelled boxes. `object` is
/// ignored unless the object stands on its victim's roof.
EvaluationLabels labelled_boxes(const Placement& placement, const Mesh& placed,
                                const Calibration& calibration, const std::optional<PictureBox>& object);

/// The own_label(); if the first camera does not show the object, its 2-D box is from the first camera that
/// does.
Label in_a_camera(Label own, const Simulated& simulated);

/// Victim::object: the plain object of the clean frame, a mid-grey cuboid that fills the placement's volume.
TexturedMesh plain_object(const Placement& placement);
/// Detections in a frame as recorded or, with Victim::object, with the plain object in it.
std::vector<Detection> clean_of(Detector& detector, const PreparedFrame& prepared, const Placement& placement,
                                const SimulationSettings& simulation, const EvaluationSettings& settings);

/// Judges one host, given its clean and attacked detections.
HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Detection> clean,
                  std::vector<Detection> attacked, const EvaluationSettings& settings,
                  const EvaluationLabels& boxes = {});

/// The entry "grown" of to_json(Evaluation), if boxes grow: success against grown boxes, {vehicles, fn_asr,
/// fp_asr, asr: {value, low, high}, hidden: as MissRates, outcomes}.
nlohmann::json grown_json(const std::vector<HostOutcome>& hosts, int meshes);

/// Shares and curves over outcomes; a host has one outcome for each mesh.
Evaluation summarize(std::vector<HostOutcome> hosts, int meshes = 1);

/// Clean detections by frame.
using CleanDetections = std::map<std::string, std::vector<Detection>>;
/// Detections in the hosts' frames as recorded. `seen`: known detections of some frames, down to
/// kScoreThresholdForAp; the detector does not run on these again.
CleanDetections clean_detections(const DetectorPool& detectors, FrameStore& store,
                                 const std::vector<HostId>& hosts, const EvaluationSettings& settings,
                                 const CleanDetections& seen = {});

/// Runs the detector on every host with each adversary on its roof. `clean` is unused with Victim::object.
Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const CleanDetections& clean, std::span<const TexturedMesh> adversaries,
                    const SimulationSettings& simulation, const EvaluationSettings& settings);
/// The same for one adversary; also computes the clean detections.
Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings);

/// JSON of an evaluation, with its strata and false positives (host_outcome.h).
nlohmann::json to_json(const Evaluation& evaluation);

// The hosts of an evaluation in its file: written by to_json(Evaluation), read back to compare evaluations.

/// [{frame, label, mesh?, track?, victim?, kind, …}]: "mesh" if there are several, "track" if known,
/// "victim": the judged neighbour's label. "clean_distance" and "attacked_distance" exist only in the
/// bird's-eye view; null if infinite.
nlohmann::json outcomes_json(const std::vector<HostOutcome>& hosts, int meshes);

/// Reads the hosts that to_json(Evaluation) wrote, in its order. They have no detections, and their new boxes
/// (listed by false_positives_json) have only the distance. InputError naming file and field.
std::vector<HostOutcome> read_outcomes(const JsonFields& evaluation);

}  // namespace mirage
