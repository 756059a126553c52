// The layout of --help: options in groups, lines as wide as the terminal and 100 columns at most, an example.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

/// Formats --help of the command and its subcommands in this way. Many options stand under headings by topic.
void format_help(CLI::App& app);

/// Puts an example before the footer of the command's help.
void add_example(CLI::App& app, const std::string& example);

/// Prints the script for "bash" or "zsh", which runs bash's: it completes commands, their options, and the
/// words that an option or an argument may be; otherwise file names. Or for "commands" a line for each
/// command, its name, a tab, its help, for the manual's pages. False for another word.
bool print_completion(const CLI::App& app, const std::string& what);

}  // namespace mirage::cli
