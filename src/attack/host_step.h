// What one host adds to a step of the attack.
#pragma once

#include "attack/stages.h"
#include "simulation/simulation.h"

namespace mirage {

/// Loss and gradient of one host: simulation, detector, objective and their VJPs. With a draw, of the host in
/// that world.
struct HostStep {
  double hide = 0, false_positive = 0;
  bool found = false;  ///< as recorded, at the score and IoU of an evaluation (EvaluationSettings)
  /// Found as recorded, and by no proposal of this step. An indication that costs no forward pass: taken
  /// before suppression, and never used by the optimiser.
  bool hidden = false;
  AdversaryGradient gradient;
  HostSeconds seconds;
};

}  // namespace mirage
