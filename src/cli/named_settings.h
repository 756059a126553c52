// Runs commands on named settings: for Python (plugins/python) and for commands that run others.
#pragma once

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/named_settings.h"

namespace mirage::cli {

/// The names that a command knows, sorted.
std::vector<std::string> setting_names(const CLI::App& command);

/// "--texel-rate=0.01" for each. InputError, naming `where` and the names there are, for one that the command
/// does not know.
std::vector<std::string> arguments_of(const NamedSettings& settings, const CLI::App& command,
                                      const std::string& where);

/// Sets what the command's options point at. InputError naming `where` for what an option does not take.
void parse_settings(CLI::App& command, const NamedSettings& settings, const std::string& where);

/// Runs a command as the command line does, OUT/result.json included, and returns what that holds. `where`
/// names the call in its errors. Throws what the command throws.
nlohmann::json run_command(const std::string& command, const NamedSettings& settings,
                           const std::string& where);

}  // namespace mirage::cli
