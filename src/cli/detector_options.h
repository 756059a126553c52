// Options that every command with a detector shares.
#pragma once

#include <CLI/CLI.hpp>

#include "cli/command.h"
#include "detection/detector.h"

namespace mirage::cli {

inline void add_detector_options(CLI::App& app, DetectorOptions& options) {
  app.add_option("--detector", options.detector, "fusion, lidar, or a plugin's path (*.so)")
      ->capture_default_str();
  app.add_option("--weights", options.weights, "weights file (default: the shipped ones)");
}

inline DetectorOptions with_common(DetectorOptions options, const Common& common) {
  options.seed = common.seed;
  options.threads = common.threads;
  return options;
}

}  // namespace mirage::cli
