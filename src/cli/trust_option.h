// --trust-run of the commands that read a run folder.
#pragma once

#include <CLI/CLI.hpp>

#include "attack/run.h"

namespace mirage::cli {

inline void add_trust_option(CLI::App& app, TrustRun& trust) {
  app.add_flag_callback(
      "--trust-run", [&trust] { trust = TrustRun::yes; },
      "load plugins and TorchScript models that the run names: they are programs, and run as you");
}

}  // namespace mirage::cli
