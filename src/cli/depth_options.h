// The option of every command that prepares frames.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

inline void add_depth_option(CLI::App& app, std::string& depth) {
  app.add_option("--depth", depth,
                 "depth completion of the photographs: ip-basic, guided (learned) or a plugin (*.so)")
      ->capture_default_str();
}

}  // namespace mirage::cli
