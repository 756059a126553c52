// Attack success by what a host vehicle is and where: range, occlusion, truncation, kind.
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

/// One part of the hosts.
struct HostPart {
  std::string by, name;
  OutcomeTest holds;
};
/// Range: 0-15, 15-30, 30-50, 50+ m (the nearer end belongs to the part). Occlusion: KITTI's four levels.
/// Truncation: up to 0.15 (KITTI's "easy") and more. Kind: HostOutcome::kind, in alphabetical order.
std::vector<HostPart> host_parts(std::span<const HostOutcome> hosts);

/// Success in one of host_parts, which may have no hosts.
struct StratumSuccess {
  std::string by;    ///< "range", "occlusion", "truncation" or "kind"
  std::string name;  ///< "15-30 m", "partly occluded", …
  int hosts = 0;     ///< of one mesh
  SuccessRates rates;
  /// Of all hosts: those on which any box stands (the rule "vanished"), clean and attacked.
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

/// What kind of vehicle each host is, where the data set tells: a generated set lays its streets out again
/// and gives cars' body styles ("hatchback", …). Empty for recorded sets and sets of other generator
/// versions, whose hosts are all of the type "Car". By host_name.
std::map<std::string, std::string> vehicle_kinds(const std::filesystem::path& data,
                                                 const std::vector<HostId>& hosts);

// How often an adversary fools a detector.
//
// For each host vehicle, with the detector run on the frame as recorded (clean) and with the adversary on the
// host's roof (attacked), after non-maximum suppression and at score ≥ score_threshold:
//   FN: the host is detected at IoU > 0.7 clean and not attacked.
//   FP: an attacked box that has IoU < 0.3 with every ground truth and no overlap with any clean detection.
// Where the victim is the object itself (Victim::object) it is judged in the host's place, by its
// own_label(); "clean" is then the frame with a plain cuboid that fills the placement's volume, judged by
// that one's.
// A detector that finds boxes in the picture alone is judged there: the host is detected attacked, too, by a
// box around it and the object (HostTruth), and the ground truth holds DontCare regions.
// FN ASR, FP ASR and ASR (FN or FP) are shares of the vehicles that were detected clean
// (Tu et al., CoRL 2021, section 4); attack/host_outcome.h has the misses by other rules. Recall–IoU runs
// over all hosts. Several meshes are judged as one: shares are means over meshes × hosts, and the intervals'
// clusters stay those of one mesh: vehicles where the data set knows them, else frames (base/intervals.h).

/// When a vehicle counts as found, and a box as a new one.
struct EvaluationSettings {
  double score_threshold = 0.3;
  double detected_iou = 0.7;
  double false_positive_iou = 0.3;
  /// What differs from vehicle to vehicle: every mesh on a vehicle meets the same draw. The detections
  /// without an object are those of the frames as recorded.
  EotSettings expectation = {};
  std::uint64_t expectation_seed = 0;
  /// How the detector is judged (Capabilities::matching); evaluate() sets it.
  Matching matching = {};
  bool quiet = false;
  /// False, on a rank that tells nothing: evaluate() fills what is kept on disk, and has no outcomes. It then
  /// opens no frame of another rank's.
  bool reports_outcomes = true;
  /// Of the pool's options (frames/frame_provenance.h); empty: clean detections are not cached.
  std::string detector_identity = {};
  /// What kind of vehicle a host is, by host_name; the label's type where it is not in here.
  std::map<std::string, std::string> kinds = {};
};

/// Outcomes, the rates over them, and their intervals.
struct Evaluation {
  std::vector<HostOutcome> hosts;  ///< meshes × hosts, a mesh after the other
  /// The same, judged against boxes that the object grows; empty where it grows none (TrueBox).
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

/// Whether answers go to disk: then a second run goes on, and ranks share their work.
bool is_cached_on_disk(FrameStore& store, const EvaluationSettings& settings);
/// For Interrupted.
const char* how_to_go_on(FrameStore& store, const EvaluationSettings& settings);
/// content_hash of every coordinate, index and texel.
std::string hash_of(const TexturedMesh& textured);

/// Which draw of the world every object on the vehicle meets.
std::uint64_t draw_of(const HostId& vehicle);

/// An object on a host as an evaluation shows it to a detector: in EvaluationSettings::expectation's draw for
/// the vehicle, or as recorded where nothing is drawn. Its arguments must outlive it.
class JudgedScene {
 public:
  /// Draws and simulates. Errors as FrameStore::placement's.
  JudgedScene(FrameStore& store, const HostId& id, const TexturedMesh& mesh,
              const SimulationSettings& simulation, const EvaluationSettings& settings);
  JudgedScene(const JudgedScene&) = delete;
  JudgedScene& operator=(const JudgedScene&) = delete;

  /// What the sensors see.
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

/// What a placement changes in how a host is judged.
struct EvaluationLabels {
  /// carried_box() of the object in the attacked picture, which Matching::in_picture alone needs.
  std::optional<PictureBox> object = {};
  std::optional<int> victim = {};  ///< Placement::neighbour: its label is judged
  /// grown_box(): the true one in the attacked frame. None: the label's.
  std::optional<Box3> grown = {};
  /// Victim::object: own_label() of the object, which is judged, and of the plain one in the clean frame.
  std::optional<Label> own = {}, plain = {};
};
/// Of an object as placed (`velo`) whose carried_box() is `object`, against labelled boxes: one that stands
/// beside the box which it grows is no part of that, nor is one that stands on another vehicle than its
/// victim.
EvaluationLabels labelled_boxes(const Placement& placement, const Mesh& placed,
                                const Calibration& calibration, const std::optional<PictureBox>& object);

/// An own_label() whose 2-D box, where the first camera shows nothing of it, is that of the first that does.
Label in_a_camera(Label own, const Simulated& simulated);

/// Victim::object: what stands there in the frame that counts as clean, a mid-grey cuboid that fills the
/// placement's volume.
TexturedMesh plain_object(const Placement& placement);
/// What the detector finds in a frame as recorded or, with Victim::object, with the plain object in it.
std::vector<Detection> clean_of(Detector& detector, const PreparedFrame& prepared, const Placement& placement,
                                const SimulationSettings& simulation, const EvaluationSettings& settings);

/// Judges one host, given its clean and attacked detections.
HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Detection> clean,
                  std::vector<Detection> attacked, const EvaluationSettings& settings,
                  const EvaluationLabels& boxes = {});

/// What to_json(Evaluation) adds as "grown", where boxes grow: the success against grown boxes, {vehicles,
/// fn_asr, fp_asr, asr: {value, low, high}, hidden: as MissRates, outcomes}.
nlohmann::json grown_json(const std::vector<HostOutcome>& hosts, int meshes);

/// Shares and curves over outcomes; with several meshes each host has as many outcomes.
Evaluation summarize(std::vector<HostOutcome> hosts, int meshes = 1);

/// By frame.
using CleanDetections = std::map<std::string, std::vector<Detection>>;
/// What the detector sees in the hosts' frames as they were recorded. `seen`: what it saw in some of them,
/// down to kScoreThresholdForAp; it is not asked about these again.
CleanDetections clean_detections(const DetectorPool& detectors, FrameStore& store,
                                 const std::vector<HostId>& hosts, const EvaluationSettings& settings,
                                 const CleanDetections& seen = {});

/// Runs the detector on every host with each of the adversaries on its roof. `clean` is not asked with
/// Victim::object.
Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const CleanDetections& clean, std::span<const TexturedMesh> adversaries,
                    const SimulationSettings& simulation, const EvaluationSettings& settings);
/// The same of one adversary; clean frames are looked at first.
Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings);

/// With the strata (evaluation.h) and the false positives (host_outcome.h).
nlohmann::json to_json(const Evaluation& evaluation);

// The hosts of an evaluation in its file: written by to_json(Evaluation), read back by who puts evaluations
// beside each other.

/// [{frame, label, mesh?, track?, victim?, kind, …}]: "mesh" where there are several, "track" where it is
/// known, "victim", the label of a neighbour that is judged, "clean_distance" and "attacked_distance" in the
/// bird's-eye view alone, null where they are infinite.
nlohmann::json outcomes_json(const std::vector<HostOutcome>& hosts, int meshes);

/// The hosts of what to_json(Evaluation) wrote, in its order, without their detections; of their new boxes
/// (those that false_positives_json listed) the distance alone. InputError naming file and field.
std::vector<HostOutcome> read_outcomes(const JsonFields& evaluation);

}  // namespace mirage
