#include "cli/completion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <vector>

#include "base/shipped_plugins.h"
#include "base/words.h"
#include "defense/adversarial_training.h"
#include "detection/defense_words.h"
#include "detection/detector.h"
#include "detection/detector_words.h"

namespace mirage::cli {
namespace {

std::vector<std::string> shipped(const char* kind) {
  std::vector<std::string> words;
  for (const ShippedPlugin& plugin : shipped_plugins(kind))
    words.insert(words.end(), plugin.words.begin(), plugin.words.end());
  return words;
}

/// Words of options that take others, too, such as a file's name.
std::vector<std::string> usual_words(const CLI::App& command, const CLI::Option& option) {
  const std::string name = option.get_name();
  if (name == "--detector") return shipped(kDetectorPlugins);
  if (name == "--depth") {
    std::vector<std::string> words = shipped("depth");
    words.emplace_back("ip-basic");
    return words;
  }
  if (name == "--rig") return shipped_names("scenes/rigs", ".toml");
  if (name == "--lidar" && command.get_name() == "generate") return shipped_names("scenes/lidars", ".toml");
  if (name == "--method") return defense_methods();
  if (name == "--weights") return {kRealWeights};
  if (name == "--rooftop") return {"shape", "box"};
  if (name == "--place") return {"roof"};
  if (name == "--mesh" && command.get_name() != "drive") return {"zoo"};
  if (name == "--sun") return {"frame", "photo"};
  if (name == "--hosts") return {"test", "train", "all"};
  if (name == "--baseline") return {"start", "sized", "ellipsoid", "cuboid", "all", "none"};
  if (name == "--expect") return {"roof", "sun", "light", "exposure", "noise", "all", "none"};
  if (name == "--camera-effects") return {"ideal", "unit", "blur", "noise"};
  if (name == "--lidar-effects")
    return {"ideal", "as-recorded", "unit", "noise", "drop-out", "divergence", "motion", "albedo"};
  if (name != "--defense") return {};
  std::vector<std::string> words = defense_methods();
  for (const char* word : {"none", "jpeg:", "ceiling:", kConsistency, kShadows}) words.emplace_back(word);
  return words;
}

/// The words of a choice, "{both,image}" in the option's type; empty where anything may stand.
std::vector<std::string> choices(const CLI::App& command, const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const auto open = type.find('{'), close = type.find('}', open);
  if (open == std::string::npos || close == std::string::npos) return usual_words(command, option);
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
    const auto words = choices(command, *option);
    if (option->get_positional()) free.insert(free.end(), words.begin(), words.end());
    if (!option->nonpositional()) continue;
    free.push_back(names(*option, " "));
    if (option->get_items_expected_max() > 0)
      text += fmt::format("          {}) words=\"{}\" ;;\n", names(*option, "|"), fmt::join(words, " "));
  }
  return text + fmt::format("          *) words=\"{}\" ;;\n", fmt::join(free, " "));
}

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
    words="{}--help --version --completion"
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

}  // namespace

bool print_completion(const CLI::App& app, const std::string& what) {
  const std::map<std::string, std::string> said = {
      {"bash", bash_completion(app)},
      {"zsh", "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n" + bash_completion(app)},
      {"commands", command_list(app)}};
  if (!said.contains(what)) return false;
  std::fputs(said.at(what).c_str(), stdout);
  return true;
}

}  // namespace mirage::cli
