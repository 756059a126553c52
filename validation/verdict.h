// The verdict on the attack: how often the detector is fooled by the rasteriser's pictures, by each rung of
// the ladder and by full Cycles, with intervals; which vehicles' outcome depends on who drew them.
#pragma once

#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

namespace mirage {

/// Of the results of vehicles (OUT/hosts/*.json): {confidence, held_back, all, pairs, flips}.
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
nlohmann::json verdict(const std::vector<nlohmann::json>& vehicles, const std::set<std::string>& test_frames);

}  // namespace mirage
