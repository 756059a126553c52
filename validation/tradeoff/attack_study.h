// Attack success at equal time: one short attack in each way of trading accuracy for speed.
#pragma once

#include <nlohmann/json.hpp>

#include "validation/tradeoff/settings.h"

namespace mirage {

/// For each quality, then for whole passes, bfloat16 and a locality of 4 m at the default quality: an attack
/// of settings.attack_seconds of iterations on the data set's training vehicles (OUT/attack_NAME, made anew),
/// then its success on the held-back ones, simulated at `exact` and detected in float over what the object
/// changes for all alike:
/// [{name, quality, precision, locality, clean_memory_mb, seconds, iterations, vehicles, asr, fn_asr, fp_asr,
/// asr_interval: 95 %}]. What the attacks reach depends on the machine.
nlohmann::json attack_study(const TradeoffSettings& settings);

}  // namespace mirage
