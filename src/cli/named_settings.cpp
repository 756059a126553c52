#include "cli/named_settings.h"

#include <algorithm>

#include "base/error.h"
#include "base/words.h"
#include "cli/field_options.h"

namespace mirage::cli {
namespace {

std::string option_called(std::string name) {
  std::replace(name.begin(), name.end(), '_', '-');
  return "--" + name;
}

bool is_setting(const std::string& option) {
  return option != "--help" && !option.empty();
}

}  // namespace

std::vector<std::string> setting_names(const CLI::App& command) {
  std::vector<std::string> names;
  for (const CLI::Option* option : command.get_options())
    for (std::string name : option->get_lnames())
      if (is_setting("--" + name)) {
        std::replace(name.begin(), name.end(), '-', '_');
        names.push_back(name);
      }
  std::sort(names.begin(), names.end());
  return names;
}

std::vector<std::string> arguments_of(const NamedSettings& settings, const CLI::App& command,
                                      const std::string& where) {
  std::vector<std::string> arguments;
  for (const auto& [name, value] : settings) {
    const std::string option = option_called(name);
    if (!is_setting(option) || !command.get_option_no_throw(option))
      throw InputError(where, name, "unknown setting", use_one_of(name, setting_names(command)));
    arguments.push_back(option + "=" + value);
  }
  return arguments;
}

void parse_settings(CLI::App& command, const NamedSettings& settings, const std::string& where) {
  std::vector<std::string> arguments = arguments_of(settings, command, where);
  std::reverse(arguments.begin(), arguments.end());  // CLI11 takes them from the back
  check_numbers(command);
  try {
    command.parse(std::move(arguments));
  } catch (const CLI::ParseError& error) {
    const Complaint complaint = complaint_of(error, command);
    throw InputError(where, complaint.option, complaint.problem, complaint.fix);
  }
}

}  // namespace mirage::cli
