#include "cli/config_file.h"

#include <toml++/toml.h>

#include <algorithm>
#include <sstream>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"

namespace mirage::cli {
namespace {

std::string text_of(const toml::node& node) {
  if (const auto text = node.value<std::string>(); text && node.is_string()) return *text;
  std::ostringstream out;
  node.visit([&](const auto& value) {
    if constexpr (toml::is_value<decltype(value)>) out << value;
  });
  return out.str();
}

}  // namespace

std::vector<std::string> apply_config(const std::vector<std::string>& arguments, const CLI::App& command) {
  std::string file;
  std::vector<std::string> given;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    if (argument == "--config" && i + 1 < arguments.size()) file = arguments[i + 1];
    if (argument.starts_with("--config=")) file = argument.substr(9);
    if (argument.starts_with("--")) given.push_back(argument.substr(0, argument.find('=')));
  }
  if (file.empty()) return arguments;
  toml::table table;
  try {
    table = toml::parse(read_file(file), file);
  } catch (const toml::parse_error& error) {
    refuse_toml(file, error.source().begin.line, std::string(error.description()));
  }
  std::vector<std::string> result = arguments;
  for (const auto& [key, node] : table) {
    const std::string option = "--" + std::string(key.str());
    const auto* known = command.get_option_no_throw(option);
    if (!known || option == "--config" || option == "--help")
      throw InputError(file, std::string(key.str()), "unknown key for mirage " + command.get_name(),
                       "see mirage " + command.get_name() + " --help for the options that a config can set");
    if (node.is_table() || node.is_array())
      throw InputError(file, std::string(key.str()), "must be a single value", "write key = value");
    if (std::find(given.begin(), given.end(), option) == given.end())
      result.push_back(option + "=" + text_of(node));
  }
  return result;
}

}  // namespace mirage::cli
