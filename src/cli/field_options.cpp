#include "cli/field_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <optional>
#include <sstream>

#include "base/config.h"
#include "base/error.h"
#include "detection/detector_settings.h"
#include "detection/process_detector.h"

namespace mirage::cli {
namespace {

/// Option names of fields whose option has another name.
std::map<std::string, std::string>& renamed() {
  static std::map<std::string, std::string> names;
  return names;
}

std::string text_of(const nlohmann::json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number_float() && !std::isfinite(value.get<double>()))
    return fmt::format("{}", value.get<double>());  // of which JSON has none
  return value.dump();
}

/// The keys that a file may have.
std::vector<std::string> option_names(const CLI::App& command) {
  std::vector<std::string> names;
  for (const CLI::Option* option : command.get_options())
    for (const std::string& name : option->get_lnames())
      if (name != "config" && name != "help") names.push_back(name);
  return names;
}

/// The value of option `name`: from the command line, else from the file, else its default. Empty if the
/// command has no such option.
std::optional<std::string> value_of(const std::string& name, const std::vector<std::string>& arguments,
                                    const nlohmann::json& table, const CLI::App& command) {
  const CLI::Option* existing = command.get_option_no_throw("--" + name);
  if (!existing) return std::nullopt;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    if (arguments[i] == "--" + name && i + 1 < arguments.size()) return arguments[i + 1];
    if (arguments[i].starts_with("--" + name + "=")) return arguments[i].substr(name.size() + 3);
  }
  if (table.contains(name)) return text_of(table.at(name));
  return existing->get_default_str();
}

/// Whether one of the words, which commas part, is a path of a plugin.
bool names_plugin(const std::string& words) {
  const std::vector<std::string> all = listed_words(words);
  return std::any_of(all.begin(), all.end(), [](const std::string& word) {
    return word.ends_with(".so") || word.find('/') != std::string::npos || is_program(word);
  });
}

/// Says how an option's value is code; empty if it is data. `value` gives other options' values. A
/// TorchScript model can have any name, so a file counts as data only if our own code reads it.
template <class Value>
std::string code_in(const std::string& key, const std::string& text, const Value& value) {
  if ((key == "detector" || key == "depth" || key == "backends" || key == "sensors" || key == "tracker") &&
      names_plugin(text))
    return "a plugin would be loaded, which is code";
  const std::optional<std::string> detector = value("detector");
  if (key == "weights" &&
      (detector ? weights_are_code(*detector) : names_plugin(value("backends").value_or(""))))
    return "weights of this detector may be code";
  if (key == "start" && detector == "camera") return "may be a TorchScript model, which is code";
  if (key == "trust-run") return "trusts the code that a run names";
  return "";
}

std::string option_called(std::string name) {
  std::replace(name.begin(), name.end(), '_', '-');
  return "--" + name;
}

/// The names that a command knows, sorted.
std::vector<std::string> setting_names(const CLI::App& command) {
  std::vector<std::string> names;
  for (const CLI::Option* option : command.get_options())
    for (std::string name : option->get_lnames())
      if (name != "help") {
        std::replace(name.begin(), name.end(), '-', '_');
        names.push_back(name);
      }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

void name_option(const Field& field) {
  if (field.option) renamed()[field.name] = field.option_name();
}

std::string with_default(const std::string& help, const std::string& otherwise) {
  return otherwise.empty() ? help : help + " (default: " + otherwise + ")";
}

std::string option_of(const CLI::App& app, const std::string& field) {
  const auto other = renamed().find(field);
  const std::string option = option_called(other == renamed().end() ? field : other->second);
  return app.get_option_no_throw(option) ? option : field;
}

CLI::Validator within(const Range& range) {
  const bool any = range.low <= -Range::kMax && range.high >= Range::kMax;
  const std::string words = any ? "" : range.words();
  return {[range](const std::string& text) -> std::string {
            double value = 0;
            if (!CLI::detail::lexical_cast(text, value) || range.contains(value)) return "";
            return fmt::format("{} is out of range; use {}", text, range.words());
          },
          words.substr(0, words.find(" (")), ""};  // without the hint for a user who missed it
}

CLI::Validator one_of(const std::vector<std::string>& words) {
  return {[words](const std::string& text) -> std::string {
            if (std::find(words.begin(), words.end(), text) != words.end()) return "";
            return fmt::format("{} is unknown; {}", text, use_one_of(text, words));
          },
          fmt::format("{{{}}}", fmt::join(words, ",")), ""};
}

OptionType type_of(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const auto colon = type.find(':');
  if (type.starts_with('{') || colon == type.npos) return {type, ""};
  return {type.substr(0, colon), type.substr(colon + 1)};
}

void check_numbers(CLI::App& app) {
  for (CLI::Option* option : app.get_options()) {
    const OptionType type = type_of(*option);
    const auto check = [&]<class Number>(Number, const char* what) {
      const std::string fix = type.limits.empty() ? what : what + (", " + type.limits);
      option->check([fix](const std::string& text) -> std::string {
        Number value = 0;
        const char *first = text.data() + (text.starts_with('+') ? 1 : 0), *end = text.data() + text.size();
        const auto [read, error] = std::from_chars(first, end, value);
        const bool number = read == end && first != end && value == value;  // NaN equals nothing
        if (number && error == std::errc()) return "";
        return fmt::format("{} is {}; use {}", text, number ? "out of range" : "not a valid number", fix);
      });
    };
    if (type.name == "UINT") check(std::uint64_t{}, "a whole number from 0");
    if (type.name == "INT") check(std::int64_t{}, "a whole number");
    if (type.name == "FLOAT") check(double{}, "a number");
  }
}

UsageError usage_error(const CLI::ParseError& error, const CLI::App& app) {
  std::string text = error.what();
  const std::string help = "see mirage " + app.get_name() + " --help";
  const auto part = [&](const std::string& mark) {  // takes what stands before it off the text
    const auto at = text.find(mark);
    std::string name = at == text.npos ? "" : text.substr(0, at);
    if (at != text.npos) text.erase(0, at + mark.size());
    return name;
  };
  const CLI::Option* option = nullptr;
  if (dynamic_cast<const CLI::RequiredError*>(&error)) {
    std::string name = part(" is required");
    option = app.get_option_no_throw(name);
    return {std::move(name), "is missing", option ? "give it: " + option->get_description() : help};
  }
  if (dynamic_cast<const CLI::ValidationError*>(&error)) {
    std::string name = part(": ");
    const auto end = text.rfind("; ");
    if (end == text.npos) return {std::move(name), text, help};
    return {std::move(name), text.substr(0, end), text.substr(end + 2)};
  }
  if (dynamic_cast<const CLI::ConversionError*>(&error)) {
    part("Could not convert: ");
    std::string name = part(" = ");
    option = app.get_option_no_throw(name);
    const std::string limits = option ? type_of(*option).limits : "";
    return {std::move(name), text + " does not fit", limits.empty() ? help : "use " + limits};
  }
  if (dynamic_cast<const CLI::ArgumentMismatch*>(&error)) {
    const std::string name = text.substr(0, text.find(':'));
    option = app.get_option_no_throw(name);
    if (const int most = option ? option->get_expected_max() : 0;
        most > 0 && text.find(": At Most ") != text.npos)
      return {name, most == 1 ? "is given more than once" : fmt::format("has more than {} values", most),
              most == 1 ? "give it once" : "leave some out"};
    if (option) return {name, "needs a value", option->get_description()};
  }
  return {"", text, help};
}

std::vector<std::string> apply_config(const std::vector<std::string>& arguments, const CLI::App& command) {
  std::string file;
  std::vector<std::string> set_options;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    const bool here = argument.starts_with("--config=");
    if (here) file = argument.substr(9);
    if (argument == "--config" && i + 1 < arguments.size()) file = arguments[i + 1];
    if (file.empty() && (here || argument == "--config"))
      throw InputError("--config", "", "names no file", "give a .toml file with options");
    if (argument.starts_with("--")) set_options.push_back(argument.substr(0, argument.find('=')));
  }
  if (file.empty()) return arguments;
  const nlohmann::json table = read_toml(file);
  const auto value = [&](const std::string& name) { return value_of(name, arguments, table, command); };
  std::vector<std::string> result = arguments;
  for (const auto& [key, written] : table.items()) {
    const std::string option = "--" + key;
    const auto* existing = command.get_option_no_throw(option);
    if (!existing || option == "--config" || option == "--help")
      throw InputError(file, key, "unknown key for mirage " + command.get_name(),
                       use_one_of(key, option_names(command)));
    if (written.is_structured() || written.is_null())
      throw InputError(file, key, "must be a single value", "write key = value");
    if (std::find(set_options.begin(), set_options.end(), option) != set_options.end()) continue;
    const std::string text = text_of(written);
    if (const std::string code = code_in(key, text, value); !code.empty())
      throw InputError(
          file, key, fmt::format("{} ({})", code, text),
          "if you trust it, give it on the command line: " + option + (key == "trust-run" ? "" : " " + text));
    result.push_back(option + "=" + text);
  }
  return result;
}

std::vector<std::string> arguments_of(const NamedSettings& settings, const CLI::App& command,
                                      const std::string& where) {
  std::vector<std::string> arguments;
  for (const auto& [name, value] : settings) {
    const std::string option = option_called(name);
    const CLI::Option* existing = option == "--help" ? nullptr : command.get_option_no_throw(option);
    if (!existing) throw InputError(where, name, "unknown setting", use_one_of(name, setting_names(command)));
    std::string text = value;
    if (existing->get_expected_max() <= 1) std::replace(text.begin(), text.end(), kListSeparator, ',');
    std::istringstream parts(text);
    for (std::string part; std::getline(parts, part, kListSeparator);)
      arguments.push_back(option + "=" + part);
    if (text.empty()) arguments.push_back(option + "=");
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
    const UsageError complaint = usage_error(error, command);
    throw InputError(where, complaint.option, complaint.problem, complaint.fix);
  }
}

}  // namespace mirage::cli
