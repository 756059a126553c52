// What --help prints: options in groups, lines as wide as the terminal and 100 columns at most, an example.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mirage::cli {

/// Makes --help of the command and of its own commands that. A command of more options than kUngrouped has
/// them under headings, by what they are about.
void format_help(CLI::App& app);
inline constexpr int kUngrouped = 15;

/// Puts an example before what the command's help ends with.
void add_example(CLI::App& app, const std::string& example);

/// The text in lines of `width` columns, all but the first indented by `indent`; a line that starts with a
/// space stays as it is.
std::string wrapped(const std::string& text, std::size_t width, std::size_t indent);

// The command tree for other programs: completion in bash and zsh, and the list of commands for the manual's
// pages. A script completes commands, their options, and the words that an option or an argument may be; file
// names where anything may stand.

/// Prints the script for "bash" or "zsh", which runs bash's; or for "commands" a line for each command, its
/// name, a tab, its help, for the manual's pages. False for another word.
bool print_completion(const CLI::App& app, const std::string& what);

}  // namespace mirage::cli
