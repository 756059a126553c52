// Log lines go to standard error through spdlog; results go to standard output.
#pragma once

#include <spdlog/spdlog.h>

namespace mirage {

/// Sets the pattern and the level (quiet: warnings and errors only).
void start_logging(bool quiet);

}  // namespace mirage
