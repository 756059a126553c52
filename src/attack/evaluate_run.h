// The gate of detection/reliance.h for the detector and the data that a command works with, kept on disk by
// content.
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

/// measure_reliance() on at most kAuditFrames of the data set's frames, spread evenly, or what is kept of it
/// in DiskCache::from_environment() for the same detector, frames and program. `identity`:
/// detector_identity() of the pool's options; empty: not cached. Shows progress unless `quiet`. `seen`, if
/// given, gets what measuring saw in the frames as recorded. Ranks share the passes; the first has the
/// result.
Reliance cached_reliance(const DetectorPool& detectors, const std::string& identity,
                         const FrameSource& source, bool quiet = true, CleanDetections* seen = nullptr);

// The vehicles that a run has chosen, to be judged or shown.

/// InputError where the frames of a split of the run that `hosts` belong to are not as the run chose its
/// vehicles in them: the numbers of labels would lead to other vehicles. Of runs that say no
/// Run::train_frames or Run::test_frames nothing is known.
void require_unchanged(const Run& run, std::span<const HostId> hosts);

/// Those of the hosts, labels of `source`, that the run was learned on: in `frames`, which are
/// frames_learned_on() of these data, or, of the run's own data, in other frames of their track.
std::vector<HostId> hosts_learned_on(const Run& run, const FrameSource& source,
                                     const std::vector<HostId>& hosts, const std::set<std::string>& frames);

// What `mirage evaluate` does: a run's adversary or objects of the user's, and controls beside them
// (attack/baseline.h), on the hosts that its options name.

/// What `mirage evaluate` is asked for.
struct EvaluationRequest {
  std::filesystem::path run;  ///< whose adversary is judged
  /// In place of a run: objects (attack/zoo.h), each judged on all usable vehicles of the data set that
  /// is asked for, or on those of `hosts_of`.
  std::vector<std::filesystem::path> meshes;
  /// Black-box transfer: the hosts are exactly this other run's test hosts, and its data set, detector,
  /// roofs, sun, depth and simulation stand where nothing else is asked for. Empty: the run's own.
  std::filesystem::path hosts_of;
  DetectorOptions detector = detector_of_the_run();  ///< `rig` is set by the data set
  std::string hosts;                                 ///< of the run: "test" (also if empty), "train" or "all"
  Overrides overrides;                               ///< of another data set all usable vehicles are judged
  TrustRun trust = TrustRun::no;                     ///< of both runs
  int random_meshes = 1;  ///< meshes of each baseline: seeds run-seed, run-seed + 1, …; 0: none
  /// Which: words of parse_baselines. Empty: "start,sized", and none with `meshes`.
  std::string baseline;
  EvaluationSettings settings;
};

/// What the learned mesh is compared with, judged on the same hosts.
struct BaselineEvaluation {
  Baseline kind = Baseline::start;
  Evaluation evaluation;
  GainOverControl net;            ///< the learned mesh's success less this one's
  Vec3d extents = Vec3d::Zero();  ///< m, of the first mesh along its axes
};

/// One of several objects, judged on the same hosts.
struct ObjectEvaluation {
  std::string name;
  Evaluation evaluation;
  Vec3d extents = Vec3d::Zero();  ///< m, along its axes
};

/// A run judged, and what it was judged on.
struct RunEvaluation {
  Run run;         ///< whose adversary was judged; with `objects` run_of_objects()
  Run target_run;  ///< the run that gave the hosts, with the settings that were in force; often the same
  std::filesystem::path hosts_of;  ///< as asked for
  DetectorOptions detector;
  EvaluationSettings settings;
  std::vector<HostId> hosts;
  SkippedHosts left_out;  ///< vehicles that were asked for, by the placement
  int trained_on = 0;     ///< hosts that the adversary was learned on, in these frames or others
  std::unique_ptr<FrameStore> store;
  DetectorPool detectors;
  Reliance reliance;   ///< of the detector on the data set: whether anything follows about images
  Evaluation learned;  ///< with `objects`: of all of them, pooled
  std::vector<NamedObject> objects;           ///< with EvaluationRequest::meshes: those
  std::vector<ObjectEvaluation> each;         ///< of `objects`, in their order
  std::vector<BaselineEvaluation> baselines;  ///< in the order asked for; none with random_meshes = 0

  /// The baseline of that kind; null if it was not judged.
  const BaselineEvaluation* baseline(Baseline kind) const;
};

/// InputError for options that contradict each other and where there are no hosts; with `meshes` as
/// read_objects(). Ranks but the first have no outcomes (EvaluationSettings::reports_outcomes).
RunEvaluation evaluate_run(const EvaluationRequest& request);

/// The learned mesh's Evaluation; of each baseline the same keys and "meshes", under its word, `start` under
/// "random"; "arms": the learned mesh (or each object by its name) and all baselines, each {name, detector,
/// rig, target, seeds, meshes, vehicles, extents_m, hidden: as MissRates, fn_asr, fp_asr, asr: {value, low,
/// high}, net: as GainOverControl, of the learned mesh over that baseline}; "net": that over `sized`;
/// "bound" (in "arms", too): a HiddenBound of a car that any of the meshes hides; and what was
/// judged: run (or meshes), data, depth, rooftop, detector, weights, defense, its reliance on its picture
/// (detection/reliance.h), simulation, sun, thresholds; hosts_of if it was asked for.
nlohmann::json to_json(const RunEvaluation& evaluation);

}  // namespace mirage
