// Attack success at equal time: one short attack in each way of trading accuracy for speed.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "detection/detector.h"
#include "validation/tradeoff/settings.h"

namespace mirage {

/// An attack of equal time, and how it fared.
struct TimedAttack {
  std::string name, quality;
  DetectorOptions detector;
  double seconds = 0;                           ///< of iterations
  int iterations = 0;                           ///< made in them
  double loss = 0;                              ///< AttackResult::loss
  int vehicles = 0;                             ///< held back and detected clean
  Interval fn_asr = {}, fp_asr = {}, asr = {};  ///< 95 %
};

/// {name, quality, precision, locality, clean_memory_mb, seconds, iterations, loss, vehicles, asr, fn_asr,
/// fp_asr, asr_interval: [low, high]}
nlohmann::json to_json(const TimedAttack& attack);

/// For each quality, then for whole passes, bfloat16 and a locality of 4 m at the default quality: an attack
/// of settings.attack_seconds of iterations on the data set's training vehicles (made anew; once it is
/// finished it is OUT/attack_NAME), then its success on the held-back ones, simulated at `exact` and detected
/// in float over what the object changes for all alike. What the attacks reach depends on the machine. None
/// if attack_seconds is 0.
std::vector<TimedAttack> attack_study(const TradeoffSettings& settings);

}  // namespace mirage
