// Validation of a run against a reference renderer: matched light (a correctness test of rasteriser, exporter
// and LiDAR), the physically based light (how far the light-weight renderers can be trusted) and the detector
// on the reference's pictures. Each vehicle's result is written as it is finished and kept by a later call.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "attack/run.h"
#include "detection/reliance.h"
#include "validation/fidelity/budget.h"
#include "validation/fidelity/summary.h"
#include "validation/fidelity/vehicle_validation.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

/// A vehicle without a result: the renderer was lost on it too often (ReferenceLost).
struct AbandonedVehicle {
  std::string name, problem;
};

/// What a validation says.
struct Validation {
  ValidationSummary summary;
  Verdict verdict;
  std::optional<BudgetReport> budget;  ///< if asked for
  Reliance reliance;
  std::vector<std::string> hosts;  ///< names of the vehicles, in the order that they were looked at
  /// With the vehicle's name; of the stopped runs before this one as well.
  std::vector<std::pair<std::string, ReferenceLoss>> losses;
  std::vector<AbandonedVehicle> failed;
  std::vector<std::string> unseen;  ///< names of vehicles on which no camera shows the object: in no figure
  /// Vehicles of verdict.judged() that the run was learned on, in these frames or in others of their track.
  int trained_on = 0;
  /// In what the evaluation that the report shows was made otherwise: detector, weights, defence and data,
  /// rules of judging, placement, and the simulation, of which this is the run's own.
  std::vector<std::string> evaluation_differences;
  ReferenceIdentity reference;
  ValidationSettings settings;  ///< as asked for
  PlaceChoice placement;        ///< of the object
};

/// Runs it; writes OUT/{hosts,scenes,pictures}/. InputError for settings, run or data that cannot be used,
/// an evaluation of another run among them; Failure if the object is in view on no vehicle, the renderer was
/// lost on every one or a program fails; Interrupted. Removes a sign-off.html of an earlier call.
Validation validate(const ValidationSettings& settings, const StartReference& start);
/// OUT/report.html from OUT/result.json, which holds to_json(), and the files beside it. InputError without
/// Python; Failure if report.py fails.
void write_report(const ValidationSettings& settings);

/// What the page says first: success under the condition nearest to reality, what its difference from the
/// first tells, and whether matched light misses a target or had nothing to measure. One sentence.
std::string headline(const Validation& validation);

/// result.json (src/README.md): the summary's fields among its own.
nlohmann::json to_json(const Validation& validation);

/// A hash of all that a vehicle's stored result depends on (base/provenance.h); one with another key is
/// recomputed. `settings`: with the run's detector, `run`: with what is asked for in its settings, InputError
/// if a file of them can't be read.
std::string validation_key(const ValidationSettings& settings, const Run& run, const std::string& frame,
                           const ReferenceIdentity& reference);

/// Vehicles of a verdict where the number of frames is not given, if the data have as many: a difference of
/// shares of 100 vehicles is told to within ten points or so.
inline constexpr std::size_t kVerdictVehicles = 100;
/// Hosts of the first `frames` frames of the run, test frames first, training frames when those run out;
/// 0: of as many whole frames as hold kVerdictVehicles.
std::vector<HostId> select_hosts(const Run& run, int frames);
/// Of what shows a run's vehicles: as select_hosts; 0: of all test frames, and of no others.
std::vector<HostId> shown_hosts(const Run& run, int frames);

/// Which of the hosts get the ladders: the first of each frame in the hosts' order, then the second of each,
/// …, `count` in all (−1: every one).
std::vector<bool> ladder_hosts(const std::vector<HostId>& hosts, int count);

}  // namespace mirage
