// The speed–accuracy study: every setting that trades the one for the other, measured on the same hosts in
// the same run, with the fronts and the settings that follow from them (`mirage tradeoff`).
#pragma once

#include <nlohmann/json.hpp>

#include "validation/tradeoff/settings.h"

namespace mirage {

/// Runs it, writes OUT/tradeoff.json, and with matplotlib OUT/tradeoff.{png,svg} and tradeoff.html; returns
/// result.json (the same as tradeoff.json). InputError for numbers out of range, and if no vehicle can be
/// used.
nlohmann::json tradeoff(const TradeoffSettings& settings);

}  // namespace mirage
