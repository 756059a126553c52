// Attack success at equal time: one short attack at each quality.
#pragma once

#include <nlohmann/json.hpp>

#include "validation/tradeoff.h"

namespace mirage {

/// For each quality an attack of settings.attack_seconds of iterations on the data set's training vehicles
/// (OUT/attack_NAME, made anew), then its success on the held-back ones, simulated at `exact` for all alike:
/// [{quality, seconds, iterations, vehicles, asr, fn_asr, fp_asr}]. What the attacks reach depends on the
/// machine.
nlohmann::json attack_study(const TradeoffSettings& settings);

}  // namespace mirage
