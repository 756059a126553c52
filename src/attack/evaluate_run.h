// What `mirage evaluate` does: a run's adversary, and random meshes beside it, on the hosts that its options
// name.
#pragma once

#include <functional>
#include <memory>
#include <optional>

#include "attack/cached_reliance.h"
#include "attack/evaluation.h"
#include "attack/run.h"

namespace mirage {

/// What `mirage evaluate` is asked for.
struct EvaluationRequest {
  std::filesystem::path run;  ///< whose adversary is judged
  /// Black-box transfer: the hosts are exactly this other run's test hosts, and its data set, detector,
  /// roofs, sun, depth and simulation stand where nothing else is asked for. Empty: the run's own.
  std::filesystem::path hosts_of;
  std::filesystem::path data;       ///< empty: the run's; of another data set all usable vehicles are judged
  DetectorOptions detector;         ///< what is empty: the run's; `rig` is set by the data set
  std::string hosts;                ///< of the run: "test" (also if empty), "train" or "all"
  std::string depth, rooftop, sun;  ///< empty: the run's
  TrustRun trust = TrustRun::no;    ///< of both runs
  int random_meshes = 1;            ///< random meshes of the seeds run-seed, run-seed + 1, …
  /// What is asked for beyond the run's simulation, given the data set that is judged on.
  std::function<void(SimulationSettings&, const std::filesystem::path& data)> adjust;
  EvaluationSettings settings;
};

/// A run judged, and what it was judged on.
struct RunEvaluation {
  Run run;    ///< whose adversary was judged
  Run stage;  ///< the run that gave the hosts, with the settings that were in force; often the same
  std::filesystem::path hosts_of;  ///< as asked for
  DetectorOptions detector;
  EvaluationSettings settings;
  std::vector<HostId> hosts;
  int trained_on = 0;  ///< hosts in frames that the adversary was trained on
  std::unique_ptr<FrameStore> store;
  DetectorPool detectors;
  Reliance reliance;  ///< of the detector on the data set: whether anything follows about images
  Evaluation learned;
  std::optional<Evaluation> random;  ///< none with random_meshes = 0
};

/// InputError for options that contradict each other and where there are no hosts.
RunEvaluation evaluate_run(const EvaluationRequest& request);

/// The learned mesh's Evaluation, with "random" (the same keys and "meshes", if any was judged) and what was
/// judged: run, data, depth, rooftop, detector, weights, defense, its reliance on its picture
/// (detection/reliance.h), simulation, sun, thresholds; hosts_of if it was asked for.
nlohmann::json to_json(const RunEvaluation& evaluation);

/// The baseline: `count` random meshes by the run's seed, limits and rules; the first is its random.glb.
std::vector<TexturedMesh> random_meshes(const Run& run, int count);

}  // namespace mirage
