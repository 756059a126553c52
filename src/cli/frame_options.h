// Options of the commands that prepare frames, and how their results are told.
#pragma once

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <string>

#include "scene/shape/shape_rooftop.h"

namespace mirage::cli {

inline void add_depth_option(CLI::App& app, std::string& depth) {
  app.add_option("--depth", depth,
                 "depth completion of the photographs: ip-basic, guided (learned) or a plugin (*.so)")
      ->capture_default_str();
}

inline constexpr const char* kRooftopHelp =
    "roof the adversary stands on: shape (fitted to the vehicle's returns), box (the label's) or a shape "
    "model (*.shape)";

inline void add_rooftop_option(CLI::App& app, std::string& rooftop) {
  app.add_option("--rooftop", rooftop, kRooftopHelp)->capture_default_str();
}

/// For the commands that read a run; empty stands for the run's.
inline void add_rooftop_option_of_run(CLI::App& app, std::string& rooftop) {
  app.add_option("--rooftop", rooftop, std::string(kRooftopHelp) + "; default: the run's");
}

/// How many roofs were fitted, for the commands' tables.
inline std::string roofs(int fitted, int from_box) {
  return fmt::format("{} fitted, {} from the labelled box", fitted, from_box);
}

}  // namespace mirage::cli
