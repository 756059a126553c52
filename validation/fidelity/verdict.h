// The verdict on the attack: how often the detector is fooled by the rasteriser's pictures, by each rung of
// the ladder and by full Cycles, with intervals; which vehicles' outcome depends on who drew them.
#pragma once

#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// Of the vehicles: {confidence, held_back, all, pairs, flips, of, arms,
/// controls, vacuous}.
///   held_back, all: {frames, vehicles, clusters, variants, difference, agree, score_correlation,
///   score_mean_difference}
///     over the vehicles of `test_frames` and over all; counts are of those detected without the adversary.
///   variants: [{name, vehicles, fn_asr, fp_asr, asr, mean_score}], "soft" (as attacked), "hard", the
///   ladder's
///     effects (over the vehicles that have one), "cycles". Shares are {value, low, high} (base/bootstrap.h;
///     clusters, by the vehicles' "track" if they have one: base/clusters.h).
///   difference: soft − cycles of each share, paired.
///   pairs: the scores on each vehicle (0: no detection there), for a scatter plot.
///   flips: vehicles hidden under one of soft and cycles and found under the other.
///   arms: [{light, returns, vehicles, fn_asr, fp_asr, asr, mean_score, difference}] of
///   validation/fidelity/arms.h, over
///     the vehicles of `of`: "held_back", or "all" where none was held back; both groups hold theirs as well.
///     difference: asr − that of the first arm (raster × ideal), paired.
///   controls: [{channel, control, vehicles, fn_asr, fp_asr, asr, mean_score, difference, flips,
///     mean_delta_logit, mean_delta_score}] against the first arm, over all vehicles. flips: how many end
///     otherwise, hidden or with a false positive.
///   vacuous: {image, lidar, bound}: whether taking the object out of that channel changes nothing: no
///   outcome
///     flips under any of the channel's controls, and the mean |Δlogit| stays below bound
///     (kLeastDeltaLogit) under each. Then who drew the object there says nothing about the attack. Null
///     without vehicles.
nlohmann::json verdict(const std::vector<VehicleResult>& vehicles, const std::set<std::string>& test_frames);

}  // namespace mirage
