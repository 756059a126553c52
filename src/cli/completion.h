// The command tree for other programs: completion in bash, and the list of commands for the manual's pages.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

/// A script for bash to source: completes commands, their options, and the words that an option or an
/// argument may be; file names where anything may stand.
std::string bash_completion(const CLI::App& app);

/// A line for each command: its name, a tab, its help.
std::string command_list(const CLI::App& app);

}  // namespace mirage::cli
