// Learning one adversary over many host vehicles.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "attack/attack_settings.h"
#include "attack/detector_pool.h"
#include "frames/hosts.h"

namespace mirage {

/// InputError if the detector does not read the one sensor that the target names: no gradient would reach the
/// adversary.
void check_target(AttackTarget target, const Detector& detector);

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
  /// With AttackSearch::automatic: {candidates: [{start, target, vertex_rate, texel_rate, seed, steps,
  /// rounds, held_out, kept_iteration}], chosen, starts, search, vehicles, steps} (attack/portfolio.h); else
  /// null.
  nlohmann::json automatic;
};

/// Runs or resumes the attack in settings.out (see attack/run.h for the files). The result is bit-identical
/// however often it was stopped. InputError when the folder holds a run with other settings.
AttackResult run_attack(const AttackSettings& settings);
/// The same with detectors at hand.
AttackResult run_attack(const AttackSettings& settings, const DetectorPool& detectors);

}  // namespace mirage
