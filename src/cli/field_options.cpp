#include "cli/field_options.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>

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
  const bool both = range.low > -Range::kMost && range.high < Range::kMost;
  return {[range](const std::string& text) -> std::string {
            double value = 0;
            if (!CLI::detail::lexical_cast(text, value) || range.contains(value)) return "";
            return fmt::format("{} is out of range, use {}", text, range.words());
          },
          both ? fmt::format("{} to {}", range.low, range.high) : "", ""};
}

}  // namespace mirage::cli
