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

/// The result of a validation.
struct Validation {
  ValidationSummary summary;
  Verdict verdict;
  std::optional<BudgetReport> budget;  ///< if asked for
  Reliance reliance;
  std::vector<std::string> hosts;  ///< names of the vehicles, in the order that they were looked at
  /// Losses with the vehicle's name, those of earlier stopped runs included.
  std::vector<std::pair<std::string, ReferenceLoss>> losses;
  std::vector<AbandonedVehicle> failed;
  std::vector<std::string> unseen;  ///< names of vehicles on which no camera shows the object: in no figure
  /// Vehicles of verdict.judged() that the run was learned on, in these frames or in others of their track.
  int trained_on = 0;
  /// How the evaluation in the report differs from this validation: detector, weights, defence and data,
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

/// The page's first sentence: success under the condition nearest to reality, the verdict on its difference
/// from the first, and whether matched light misses a target or had nothing to measure.
std::string headline(const Validation& validation);

/// result.json (src/README.md): the summary's fields among its own.
nlohmann::json to_json(const Validation& validation);

/// A hash of everything that a vehicle's stored result depends on (base/provenance.h); a result with another
/// key is recomputed. `settings`: with the run's detector, `run`: with what is asked for in its settings,
/// InputError if a file of them can't be read.
std::string validation_key(const ValidationSettings& settings, const Run& run, const std::string& frame,
                           const ReferenceIdentity& reference);

/// Vehicles of a verdict if the number of frames is not set and the data have that many: 100 vehicles tell a
/// difference of shares to within about ten points.
inline constexpr std::size_t kVerdictVehicles = 100;
/// Hosts of the first `frames` frames of the run, test frames first, training frames when those run out;
/// 0: of as many whole frames as hold kVerdictVehicles.
std::vector<HostId> select_hosts(const Run& run, int frames);
/// The hosts that pages of a run show: as select_hosts, but 0 means all test frames and no others.
std::vector<HostId> shown_hosts(const Run& run, int frames);

/// Which of the hosts get the ladders: the first of each frame in the hosts' order, then the second of each,
/// …, `count` in all (−1: every one).
std::vector<bool> ladder_hosts(const std::vector<HostId>& hosts, int count);

}  // namespace mirage
