// Learning one adversary over many host vehicles.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "attack/adversary.h"
#include "attack/buildable.h"
#include "attack/detector_pool.h"
#include "attack/expectation.h"
#include "attack/hosts.h"
#include "attack/objective.h"
#include "attack/rendered_pictures.h"
#include "scene/depth/learned_depth.h"
#include "scene/shape/shape_rooftop.h"

namespace mirage {

/// Whose gradient reaches the adversary. Both sensors always see it (modality gating).
enum class AttackTarget { both, image, lidar, random };
/// InputError for any other word.
AttackTarget parse_target(const std::string& word);

/// InputError if the detector does not read the one sensor that the target names: no gradient would reach the
/// adversary.
void check_target(AttackTarget target, const Detector& detector);

/// What of the adversary is learned; the rest stays as it starts.
/// size: the half lengths of the start's ellipsoid alone, as a control (adversary.h, half_length_gradient).
enum class AttackParts { both, shape, texture, size };
/// InputError for any other word.
AttackParts parse_parts(const std::string& word);

/// What run.json calls the simulation's own pictures.
inline constexpr const char* kRasterRenderer = "raster";

/// Everything that decides an attack's result: data, detector, what is attacked and learned, rates and
/// limits.
struct AttackSettings {
  std::filesystem::path data, out;
  DetectorOptions detector;
  std::string weights_hash;           ///< content_hash of the weights; run_attack(settings) fills it in
  std::string depth = kDefaultDepth;  ///< depth completion of the photographs (scene/depth/learned_depth.h)
  std::string rooftop = kDefaultRooftop;  ///< what finds the roofs (scene/shape/shape_rooftop.h)
  std::string sun = kDefaultSun;          ///< where the sun stands (scene/sun.h)
  std::string target = "both", parts = "both";
  Expectation expectation;
  BuildableSettings buildable;
  int iterations = 300;
  /// > 0: the attack ends where the objective on vehicles held out from training (validation_part.h) has not
  /// improved for so many steps, or after `iterations`, and the mesh with the best of its checks is what it
  /// learned. 0: all training vehicles are learned on, and the last mesh is kept.
  int until_plateau = 0;
  int validation_every = 20;  ///< steps between two checks of that objective
  /// > 0: iterations end after so many seconds, which makes the result depend on the machine.
  double seconds = 0;
  int batch = 2;  ///< hosts an iteration; their losses are averaged
  std::uint64_t seed = 0;
  double vertex_rate = 1e-3, texel_rate = 4e-3;
  double min_view = 0.7;
  int checkpoint_every = 10;      ///< iterations
  double checkpoint_seconds = 0;  ///< > 0: also where so many seconds have passed since the last one
  bool quiet = false;
  AdversaryLimits limits;
  ObjectiveSettings objective;
  SimulationSettings simulation;
  /// Who draws the object for the detector; null: the simulation's own rasteriser.
  std::shared_ptr<ObjectRenderer> renderer;
  Renewal renewal;  ///< of its pictures
};

/// What an attack ends with, beside the files in AttackSettings::out.
struct AttackResult {
  int vehicles_train = 0, vehicles_test = 0, iterations = 0;
  double loss = 0;  ///< mean of the last tenth of the iterations
  double seconds_per_iteration = 0;
  RooftopCount rooftops;     ///< of the vehicles of both splits
  nlohmann::json buildable;  ///< buildable_report of the adversary
  nlohmann::json stages;     ///< where this process's time went (attack/stages.h)
  /// With until_plateau: {stopped, best_iteration, best, kept_iteration, vehicles, frames, steps, every,
  /// iterations, values}; else null. kept_iteration: of the mesh that was written.
  nlohmann::json plateau;
};

/// Runs or resumes the attack in settings.out (see attack/run.h for the files). The result is bit-identical
/// however often it was stopped. InputError when the folder holds a run with other settings.
AttackResult run_attack(const AttackSettings& settings);
/// The same with detectors at hand.
AttackResult run_attack(const AttackSettings& settings, const DetectorPool& detectors);

}  // namespace mirage
