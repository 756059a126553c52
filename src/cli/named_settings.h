// --config FILE.toml: keys are the command's option names without the dashes; the command line wins. Such
// files are passed on like data sets are, so they hold settings and no code.
#pragma once

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/field_text.h"

namespace mirage::cli {

/// Arguments with the file's keys turned into options, where the command line doesn't give them already.
/// InputError naming file and key for: an unreadable file, a syntax error, an unknown key, and what would run
/// code (a plugin, weights that may be a TorchScript model, trust in a run's code).
std::vector<std::string> apply_config(const std::vector<std::string>& arguments, const CLI::App& command);

// Runs commands on named settings: for Python (plugins/python) and for commands that run others.

/// Between the entries of a list in a NamedSettings' text. The "unit separator", which stands in no path and
/// no word.
inline constexpr char kListSeparator = '\x1f';

/// The names that a command knows, sorted.
std::vector<std::string> setting_names(const CLI::App& command);

/// "--texel-rate=0.01" for each; one for each entry of a list where the option takes several. InputError,
/// naming `where` and the names there are, for one that the command does not know.
std::vector<std::string> arguments_of(const NamedSettings& settings, const CLI::App& command,
                                      const std::string& where);

/// Sets what the command's options point at. InputError naming `where` for what an option does not take.
void parse_settings(CLI::App& command, const NamedSettings& settings, const std::string& where);

/// Runs a command as the command line does, OUT/result.json included, and returns what that holds. `where`
/// names the call in its errors. Throws what the command throws.
nlohmann::json run_command(const std::string& command, const NamedSettings& settings,
                           const std::string& where);

}  // namespace mirage::cli
