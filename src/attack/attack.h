// Learning one adversary over many host vehicles.
#pragma once

#include "attack/attack_result.h"
#include "attack/detector_pool.h"

namespace mirage {

/// Runs or resumes the attack in settings.out (see attack/run.h for the files). The result is bit-identical
/// however often the run was stopped. InputError if the folder holds a run with other settings.
AttackResult run_attack(const AttackSettings& settings);
/// The same with detectors that are already loaded.
AttackResult run_attack(const AttackSettings& settings, const DetectorPool& detectors);

}  // namespace mirage
