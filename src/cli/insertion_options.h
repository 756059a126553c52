// The options of one insertion.
#pragma once

#include <set>
#include <string>

#include "cli/frame_options.h"

namespace mirage::cli {

/// What an insertion can be asked for: one table for `mirage simulate` and for mirage.insert in Python.
struct InsertionOptions : FrameSource {
  QualityOption quality{"default"};
  LidarEffectsOption lidar_effects{"ideal"};
  SimulationSettings simulation;

  /// `skip`: fields that are no options there.
  void add(CLI::App& app, std::set<std::string> skip = {}) {
    add_fields(app, static_cast<FrameSource&>(*this), std::move(skip));
    quality.add(app);
    add_fields(app, simulation, {"lidar_gradient"});  // an insertion alone has no detector that knows
    lidar_effects.add(app);
  }
  /// Once the options are parsed.
  void apply() {
    quality.apply(simulation);
    lidar_effects.check();
  }
  /// The settings for a sweep of this unit, which has `recorded` effects, with noise drawn by `seed`.
  SimulationSettings for_unit(const LidarModel& unit, const std::string& recorded, std::uint64_t seed) const {
    SimulationSettings settings = simulation;
    lidar_effects.apply(settings, unit, recorded, seed);
    return settings;
  }
};

}  // namespace mirage::cli
