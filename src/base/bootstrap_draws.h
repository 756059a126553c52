// What the bootstraps of one level (bootstrap.h) and of two (crossed_bootstrap.h) have in common.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "base/bootstrap.h"
#include "base/random.h"

namespace mirage {

/// The statistic of all items once, and its percentile interval over the replicates; NaN and infinite ends as
/// bootstrap_statistic's. `draw` writes how often each item is drawn in a replicate.
Interval statistic_of_draws(std::size_t items,
                            const std::function<void(std::uint64_t replicate, std::span<int> drawn)>& draw,
                            const std::function<double(std::span<const int> drawn)>& statistic,
                            const BootstrapSettings& settings);

/// How often each of `drawn` comes up in so many draws.
void draw_with_replacement(RandomStream& random, std::size_t draws, std::span<int> drawn);

}  // namespace mirage
