// The options of one insertion.
#pragma once

#include <string>

#include "cli/frame_options.h"

namespace mirage::cli {

/// What an insertion can be asked for: one table for `mirage simulate` and for mirage.insert in Python.
struct InsertionOptions {
  std::string depth = "ip-basic", rooftop = kDefaultRooftop, sun = kDefaultSun;
  QualityOption quality{"default"};
  LightOption light;
  SimulationSettings simulation;

  void add(CLI::App& app) {
    add_depth_option(app, depth);
    add_rooftop_option(app, rooftop);
    quality.add(app);
    add_camera_options(app, simulation);
    light.add(app, "plain");
    add_sun_option(app, sun);
  }
  /// Once the options are parsed.
  void apply() {
    quality.apply(simulation);
    light.apply(simulation);
  }
};

}  // namespace mirage::cli
