// Log lines go to standard error through spdlog; results go to standard output.
#pragma once

#include <spdlog/spdlog.h>

namespace mirage {

/// Sets the pattern and the level (quiet: warnings and errors only).
void start_logging(bool quiet);
/// From now on start_logging is always quiet, or no longer: for a program that shows results itself.
void keep_logging_quiet(bool quiet);

}  // namespace mirage
