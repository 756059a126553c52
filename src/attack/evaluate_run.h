// The gate of detection/reliance.h for a command's detector and data, cached on disk by content.
#pragma once

#include <filesystem>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "attack/baseline.h"
#include "attack/detector_pool.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "attack/zoo.h"
#include "detection/reliance.h"

namespace mirage {

/// measure_reliance() on at most kAuditFrames of the data set's frames, spread evenly, or the cached result
/// in DiskCache::from_environment() for the same detector, frames and program. `identity`:
/// detector_identity() of the pool's options; empty: not cached. Shows progress unless `quiet`. `seen`, if
/// not null, receives the detections measured in frames as recorded. Ranks share the passes; only the first
/// has the result.
Reliance cached_reliance(const DetectorPool& detectors, const std::string& identity,
                         const FrameSource& source, bool quiet = true, CleanDetections* seen = nullptr);

// The vehicles that a run has selected.

/// InputError if the frames of a split that contains some of `hosts` have changed since the run chose its
/// vehicles: label numbers would then mean other vehicles. Runs without Run::train_frames or Run::test_frames
/// are not checked.
void require_unchanged(const Run& run, std::span<const HostId> hosts);

/// The hosts (labels of `source`) that the run was learned on: hosts in `frames`, the frames_learned_on() of
/// this data. In the run's own data, also hosts with the track of a training vehicle.
std::vector<HostId> hosts_learned_on(const Run& run, const FrameSource& source,
                                     const std::vector<HostId>& hosts, const std::set<std::string>& frames);

// `mirage evaluate`: evaluates a run's adversary or the user's objects, with controls (attack/baseline.h), on
// the hosts that its options select.

/// Inputs of `mirage evaluate`.
struct EvaluationRequest {
  std::filesystem::path run;  ///< whose adversary is judged
  /// Instead of a run: objects (attack/zoo.h), each judged on all usable vehicles of the requested data set,
  /// or on those of `hosts_of`.
  std::vector<std::filesystem::path> meshes;
  /// Black-box transfer: the hosts are exactly this other run's test hosts, and its data set, detector,
  /// roofs, sun, depth and simulation are the defaults. Empty: those of `run`.
  std::filesystem::path hosts_of;
  DetectorOptions detector = detector_of_the_run();  ///< `rig` is set by the data set
  std::string hosts;                                 ///< of the run: "test" (also if empty), "train" or "all"
  Overrides overrides;                               ///< another data set: judges all its usable vehicles
  TrustRun trust = TrustRun::no;                     ///< of both runs
  int random_meshes = 1;  ///< meshes of each baseline: seeds run-seed, run-seed + 1, …; 0: none
  /// Words of parse_baselines. Empty: "start,sized", or "none" with `meshes`.
  std::string baseline;
  EvaluationSettings settings;
};

/// A baseline of the learned mesh, evaluated on the same hosts.
struct BaselineEvaluation {
  Baseline kind = Baseline::start;
  Evaluation evaluation;
  GainOverControl net;            ///< the learned mesh's success minus this one's
  Vec3d extents = Vec3d::Zero();  ///< m, of the first mesh along its axes
};

/// One of several objects, evaluated on the same hosts.
struct ObjectEvaluation {
  std::string name;
  Evaluation evaluation;
  Vec3d extents = Vec3d::Zero();  ///< m, along its axes
};

/// Evaluation of a run, with its hosts, detector and settings.
struct RunEvaluation {
  Run run;         ///< whose adversary was judged; with `objects` run_of_objects()
  Run target_run;  ///< the run that gave the hosts, with the effective settings; often the same run
  std::filesystem::path hosts_of;  ///< as asked for
  DetectorOptions detector;
  EvaluationSettings settings;
  std::vector<HostId> hosts;
  SkippedHosts left_out;  ///< requested vehicles that the placement left out
  int trained_on = 0;     ///< hosts used in training, in these or other frames
  std::unique_ptr<FrameStore> store;
  DetectorPool detectors;
  Reliance reliance;                          ///< use of the picture by the detector on this data
  Evaluation learned;                         ///< with `objects`: pooled over all objects
  std::vector<NamedObject> objects;           ///< of EvaluationRequest::meshes
  std::vector<ObjectEvaluation> each;         ///< of `objects`, in their order
  std::vector<BaselineEvaluation> baselines;  ///< in the requested order; empty if random_meshes = 0

  /// The baseline of that kind; null if it was not judged.
  const BaselineEvaluation* baseline(Baseline kind) const;
};

/// InputError for contradictory options, or if there are no hosts; with `meshes` also as read_objects(). Only
/// the first rank has outcomes (EvaluationSettings::reports_outcomes).
RunEvaluation evaluate_run(const EvaluationRequest& request);

/// The learned mesh's Evaluation; for each baseline the same keys and "meshes", under its word (`start` under
/// "random"); "arms": the learned mesh (or each object by its name) and all baselines, each {name, detector,
/// rig, target, seeds, meshes, vehicles, extents_m, hidden: as MissRates, fn_asr, fp_asr, asr: {value, low,
/// high}, net: as GainOverControl, of the learned mesh over that baseline}; "net": the gain over `sized`;
/// "bound" (also in "arms"): a HiddenBound over cars that any mesh hides. Also the inputs: run (or meshes),
/// data, depth, rooftop, detector, weights, defense, its reliance on its picture (detection/reliance.h),
/// simulation, sun, thresholds; hosts_of if requested.
nlohmann::json to_json(const RunEvaluation& evaluation);

}  // namespace mirage
