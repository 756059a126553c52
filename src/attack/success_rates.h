// Success rates over outcomes (attack/evaluation.h has their definitions).
#pragma once

#include <optional>
#include <span>

#include "attack/host_outcome.h"
#include "base/intervals.h"

namespace mirage {

/// Shares of the vehicles that were detected clean, with 95 % intervals (base/clusters.h).
struct SuccessRates {
  Interval fn_asr, fp_asr, asr;
};
/// Over those outcomes that count: `hosts` whose detection was clean. With `iou`, as if that were
/// EvaluationSettings::detected_iou.
SuccessRates success_rates(std::span<const HostOutcome* const> hosts, std::optional<double> iou = {});

}  // namespace mirage
