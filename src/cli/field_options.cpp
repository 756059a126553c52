#include "cli/field_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <map>

#include "base/words.h"

namespace mirage::cli {
namespace {

/// Fields whose option has another name.
std::map<std::string, std::string>& renamed() {
  static std::map<std::string, std::string> names;
  return names;
}

}  // namespace

void name_option(const Field& field) {
  if (field.option) renamed()[field.name] = field.option_name();
}

std::string option_of(const CLI::App& app, const std::string& field) {
  const auto other = renamed().find(field);
  std::string option = "--" + (other == renamed().end() ? field : other->second);
  std::replace(option.begin(), option.end(), '_', '-');
  return app.get_option_no_throw(option) ? option : field;
}

CLI::Validator within(const Range& range) {
  const bool any = range.low <= -Range::kMost && range.high >= Range::kMost;
  const std::string words = any ? "" : range.words();
  return {[range](const std::string& text) -> std::string {
            double value = 0;
            if (!CLI::detail::lexical_cast(text, value) || range.contains(value)) return "";
            return fmt::format("{} is out of range; use {}", text, range.words());
          },
          words.substr(0, words.find(" (")), ""};  // without what is said to who missed it
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
        return fmt::format("{} is {}; use {}", text, number ? "out of range" : "no such number", fix);
      });
    };
    if (type.name == "UINT") check(std::uint64_t{}, "a whole number from 0");
    if (type.name == "INT") check(std::int64_t{}, "a whole number");
    if (type.name == "FLOAT") check(double{}, "a number");
  }
}

Complaint complaint_of(const CLI::ParseError& error, const CLI::App& app) {
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
    if (option) return {name, "needs a value", option->get_description()};
  }
  return {"", text, help};
}

}  // namespace mirage::cli
