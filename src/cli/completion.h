// The command tree for other programs: completion in bash and zsh, and the list of commands for the manual's
// pages. A script completes commands, their options, and the words that an option or an argument may be; file
// names where anything may stand.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

/// Prints the script for "bash" or "zsh", which runs bash's; or for "commands" a line for each command, its
/// name, a tab, its help, for the manual's pages. False for another word.
bool print_completion(const CLI::App& app, const std::string& what);

}  // namespace mirage::cli
