#include "cli/completion.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

namespace mirage::cli {
namespace {

/// The words of a choice, "{both,image}" in the option's type; empty where anything may stand.
std::vector<std::string> choices(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const auto open = type.find('{'), close = type.find('}', open);
  if (open == std::string::npos || close == std::string::npos) return {};
  return CLI::detail::split(type.substr(open + 1, close - open - 1), ',');
}

std::string names(const CLI::Option& option, const char* separator) {
  std::vector<std::string> all;
  for (const std::string& name : option.get_lnames()) all.push_back("--" + name);
  for (const std::string& name : option.get_snames()) all.push_back("-" + name);
  return fmt::format("{}", fmt::join(all, separator));
}

/// Cases of the word before the one to complete, for one command; what follows an option with a value is one
/// of its words or a file.
std::string cases_of(const CLI::App& command) {
  std::string text;
  std::vector<std::string> free;
  for (const CLI::Option* option : command.get_options()) {
    const auto words = choices(*option);
    if (option->get_positional()) free.insert(free.end(), words.begin(), words.end());
    if (!option->nonpositional()) continue;
    free.push_back(names(*option, " "));
    if (option->get_items_expected_max() > 0)
      text += fmt::format("          {}) words=\"{}\" ;;\n", names(*option, "|"), fmt::join(words, " "));
  }
  return text + fmt::format("          *) words=\"{}\" ;;\n", fmt::join(free, " "));
}

}  // namespace

std::string bash_completion(const CLI::App& app) {
  std::string cases, commands;
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
    commands += command->get_name() + " ";
    cases += fmt::format("      {})\n        case \"$previous\" in\n{}        esac ;;\n", command->get_name(),
                         cases_of(*command));
  }
  return fmt::format(R"(# Completion of mirage in bash: what `mirage --completion bash` prints.
_mirage() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}} words=""
  # --option=value comes as three words.
  if [[ $current == "=" ]]; then
    current=""  # and `previous` is the option
  elif [[ $previous == "=" ]]; then
    previous=${{COMP_WORDS[COMP_CWORD-2]}}
  fi
  if ((COMP_CWORD == 1)); then
    words="{}--help --version"
  else
    case "${{COMP_WORDS[1]}}" in
{}    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _mirage mirage
)",
                     commands, cases);
}

std::string command_list(const CLI::App& app) {
  std::string text;
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
    text += command->get_name() + "\t" + command->get_description() + "\n";
  return text;
}

}  // namespace mirage::cli
