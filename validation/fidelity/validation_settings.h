// What a validation is asked for.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/provenance.h"
#include "validation/fidelity/budget.h"

namespace mirage {

struct ValidationSettings {
  std::filesystem::path run, out;
  Overrides asked;  ///< in place of the run's settings
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
  std::uint64_t seed = 0;
  bool quiet = false;
  /// What result.json says that it is made of: the command's options, to which validate() adds.
  std::shared_ptr<Provenance> made_of = std::make_shared<Provenance>();
};

}  // namespace mirage
