// What `mirage --version` says.
#pragma once

#include <string>

namespace mirage::cli {

/// "mirage 0.1.0 (commit ea8efec)"; for sources without their history: "mirage 0.1.0 (sources without git)".
std::string version();

}  // namespace mirage::cli
