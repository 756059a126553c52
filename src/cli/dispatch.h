// Parses `mirage <command> …`, runs the command, and turns errors into exit codes.
#pragma once

#include <string>
#include <vector>

namespace mirage::cli {

/// Exit code: 0 done, 1 failed, 2 bad arguments or bad input. Errors print one line on standard error.
int dispatch(std::vector<std::string> arguments);

}  // namespace mirage::cli
