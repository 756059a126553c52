// Running the cases: what is finished is kept, and what is not is run. Under mpirun the ranks take cases side
// by side, each one whole: a case is its rank's while that holds the lock of the case's folder, and what
// became of it the others read from OUT/steps, which all of them must see.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>

#include "validation/paper/evidence.h"

namespace mirage::paper {

/// Runs one command of mirage to its end; throws what it throws.
using Execute = std::function<void(const std::string& command, const NamedSettings& settings)>;

/// Whether the case's folder holds the result of exactly these settings, made of what its inputs are now.
bool is_finished(const Case& command, const std::filesystem::path& out);

/// Executes the cases that are not finished, in order. One that fails, and all that need it, become failed
/// steps; an interrupt (base/error.h, Interrupted) ends everything. A call of all ranks, each of which learns
/// how every case went.
std::map<std::string, Step> execute(const Experiments& experiments, const ReproduceSettings& settings,
                                    const Execute& run);

}  // namespace mirage::paper
