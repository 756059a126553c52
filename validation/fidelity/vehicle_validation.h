// The settings of a validation, and its work on one vehicle.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/provenance.h"
#include "validation/fidelity/budget.h"
#include "validation/fidelity/ladders.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

struct ValidationSettings {
  std::filesystem::path run, out;
  Overrides overrides;  ///< in place of the run's settings
  DetectorOptions detector = detector_of_the_run();
  EvaluationSettings evaluation_settings;
  TrustRun trust = TrustRun::no;     ///< whether code that the run names may be loaded
  std::filesystem::path evaluation;  ///< result.json of mirage evaluate, or its folder; for the report only
  std::filesystem::path tradeoff;    ///< the same of mirage tradeoff
  int frames = 0;                    ///< 0: as many as hold kVerdictVehicles
  int samples = 64;                  ///< Cycles samples a pixel
  double noise = 0;                  ///< > 0: samples are chosen for this noise (share of the mean radiance)
  int ladder = -1;    ///< vehicles with all rungs of the ladders; −1: 4, or all with a budget
  double budget = 0;  ///< > 0: choose the cheapest rung within this error (budget.h); ladder on all
  BudgetOf budget_of = BudgetOf::radiance;
  double budget_confidence = 0.9;  ///< share of unseen scenes that are to be within the budget
  bool sign_off = false;           ///< write a page to sign beside the report, too
  /// Manufacturing tolerances of the object, drawn for each vehicle as by `mirage evaluate --expect` of the
  /// same seed: words of parse_expectation that require_built takes.
  std::string expect = "none";
  std::uint64_t seed = 0;
  bool quiet = false;
  /// The provenance in result.json: the command's options, to which validate() adds.
  std::shared_ptr<Provenance> provenance = std::make_shared<Provenance>();
};

// The outcomes behind the verdict at one vehicle. The detector sees the object as the attack learned it, then
// in three kinds of light with two kinds of returns. Controls take one sensor's view of the object away.

/// The frame's picture in each of its cameras, by their numbers; null: as recorded.
using Pictures = std::vector<const ImageF*>;

/// The detector's outcome for pictures of the frame and a sweep.
using ViewEvaluator = std::function<OutcomeResult(const Pictures& pictures, const Sweep& sweep)>;

/// Conditions and controls of a vehicle.
///   conditions: the first is learned × learned, `learned` itself. Then light "raster" (plain), "visible"
///     (with visibility, edges as the scene's) or "cycles" (`cycles`), by returns "ideal" (thin noiseless
///     rays) or "realistic" (all effects of realistic_returns).
///   controls, by channel, against that first condition.
///     image, "noise": the object's pixels replaced by noise, uniform in each pixel and channel;
///     image, "photograph": the picture as recorded, the object unseen;
///     lidar, "no returns": the sweep as recorded, the object unmet.
/// `attacked`: simulate() with the scene's settings. `learned`: with the run's own, which may have other
/// light, edges and sensors' effects.
VerdictResults evaluate_conditions(const HostScene& scene, const Simulated& attacked,
                                   const Simulated& learned, const Pictures& cycles,
                                   const ViewEvaluator& evaluate);

// Computes everything that `mirage validate` reports on one vehicle.

/// The context that the vehicles of a validation share.
struct ValidationContext {
  const ValidationSettings& settings;
  const Run& run;
  const SimulationSettings& learned;  ///< the run's own settings, which may differ from `run`'s
  FrameStore& store;
  Detector& detector;
  ReferenceRenderer& renderer;
  std::map<std::string, std::vector<Detection>> clean;  ///< a frame's clean detections serve all its vehicles
};

/// Writes the vehicle's scene and pictures under settings.out. An object out of view has no figures.
/// ReferenceLost if the renderer was lost too often on one of its renders.
VehicleResult validate_vehicle(ValidationContext& context, const HostId& id, bool with_ladder);

}  // namespace mirage
