// The speed–accuracy study: every setting that trades the one for the other, measured on the same hosts in
// the same run, with the fronts and the settings that follow from them (`mirage tradeoff`).
#pragma once

#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/result.h"

namespace mirage {

/// Runs it, writes OUT/tradeoff.json (to_json of the result without its plots and page), and with matplotlib
/// OUT/tradeoff.{png,svg} and tradeoff.html. InputError for numbers out of range, and if no vehicle can be
/// used. `start`: of settings.cycles.
TradeoffResult tradeoff(const TradeoffSettings& settings, const StartReference& start = {});

}  // namespace mirage
