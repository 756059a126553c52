#include "base/fields.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <sstream>

namespace mirage {

std::string Range::words() const {
  if (low == kPositive.low) return high == kMost ? "above 0" : fmt::format("above 0, at most {}", high);
  if (low == -kMost) return high == kMost ? "a number" : fmt::format("at most {}", high);
  if (high == kMost) return fmt::format("at least {}", low);
  // Thresholds and shares are often given in percent.
  return fmt::format("{} to {}{}", low, high, low == 0 && high == 1 ? " (70 % is 0.7)" : "");
}

std::string Field::option_name() const {
  std::string text = option ? option : name;
  std::replace(text.begin(), text.end(), '_', '-');
  return text;
}

std::vector<std::string> listed_words(const std::string& text) {
  std::vector<std::string> words;
  std::istringstream list(text);
  for (std::string word; std::getline(list, word, ',');) words.push_back(word);
  return words;
}

double parse_number(const std::string& text, const std::string& field) {
  double value = 0;
  const char *begin = text.data() + (text.starts_with('+') ? 1 : 0), *end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(begin, end, value);
  if (error != std::errc() || stop != end || begin == end)
    throw FieldError(field, text, "is no number", "use a number");
  return value;
}

void check_number(const Field& field, double value) {
  if (!field.range.contains(value))
    throw FieldError(field.name, fmt::format("{}", value), "out of range", "use " + field.range.words());
}

}  // namespace mirage
