// What --help prints: options in groups, lines as wide as the terminal and 100 columns at most, an example.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

/// Makes --help of the command and of its own commands that. A command of many options has them under
/// headings, by what they are about.
void format_help(CLI::App& app);

/// Puts an example before what the command's help ends with.
void add_example(CLI::App& app, const std::string& example);

/// Prints the script for "bash" or "zsh", which runs bash's: it completes commands, their options, and the
/// words that an option or an argument may be; file names where anything may stand. Or for "commands" a line
/// for each command, its name, a tab, its help, for the manual's pages. False for another word.
bool print_completion(const CLI::App& app, const std::string& what);

}  // namespace mirage::cli
