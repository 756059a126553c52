// Validation of a run against Blender Cycles: matched light (a correctness test of rasteriser, exporter and
// LiDAR), the physically based light (how far the light-weight renderers can be trusted) and the detector on
// the Cycles pictures. Each vehicle's result is written as it is finished and kept by a later call.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "attack/run.h"
#include "validation/fidelity/validation_settings.h"

namespace mirage {

/// Runs it and returns result.json (src/README.md); writes OUT/{hosts,scenes,pictures}/, OUT/report.html.
nlohmann::json validate(const ValidationSettings& settings);

/// What a kept vehicle's result depends on, as a hash; one of another key is made again. `settings`: with
/// the run's detector, `run`: with what is asked for in its settings, `blender`: its version. Failure if a
/// program or the weights can't be read.
std::string validation_key(const ValidationSettings& settings, const Run& run, const std::string& blender);

/// Vehicles of a verdict where the number of frames is not given, if the data have as many: a difference of
/// shares of 100 vehicles is told to within ten points or so.
inline constexpr std::size_t kVerdictVehicles = 100;
/// Hosts of the first `frames` frames of the run, test frames first, training frames when those run out;
/// 0: of as many whole frames as hold kVerdictVehicles.
std::vector<HostId> select_hosts(const Run& run, int frames);

/// Which of the hosts get the ladders: the first of each frame in the hosts' order, then the second of each,
/// …, `count` in all (−1: every one).
std::vector<bool> ladder_hosts(const std::vector<HostId>& hosts, int count);

}  // namespace mirage
