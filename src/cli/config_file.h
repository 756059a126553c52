// --config FILE.toml: keys are the command's option names without the dashes; the command line wins. Such
// files are passed on like data sets are, so they hold settings and no code.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

namespace mirage::cli {

/// Arguments with the file's keys turned into options, where the command line doesn't give them already.
/// InputError naming file and key for: an unreadable file, a syntax error, an unknown key, and what would run
/// code (a plugin, weights that may be a TorchScript model, trust in a run's code).
std::vector<std::string> apply_config(const std::vector<std::string>& arguments, const CLI::App& command);

}  // namespace mirage::cli
