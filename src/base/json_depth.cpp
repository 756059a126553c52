#include "base/json_depth.h"

#include <fmt/format.h>

#include "base/error.h"

namespace mirage {

namespace {

constexpr const char* kFix = "write the file again with the program that made it";

/// visit(place, character) for those outside of texts.
template <class Visit>
void for_each_unquoted(std::string_view text, const Visit& visit) {
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c == '\\') ++i;
      quoted = c != '"';
    } else if (c == '"') {
      quoted = true;
    } else {
      visit(i, c);
    }
  }
}

}  // namespace

void check_json_depth(std::string_view text, const std::string& where, const std::string& field) {
  int depth = 0;
  for_each_unquoted(text, [&](std::size_t i, char c) {
    if (c == '[' || c == '{') {
      if (++depth > kDeepestJson)
        throw InputError(where, field, fmt::format("byte {}: nested deeper than {} levels", i, kDeepestJson),
                         kFix);
    } else if (c == ']' || c == '}') {
      --depth;
    }
  });
}

void check_json_values(std::string_view text, const std::string& where, std::size_t most,
                       std::size_t most_lists) {
  std::size_t count = 1, lists = 0;
  for_each_unquoted(text, [&](std::size_t, char c) {
    const bool list = c == '[' || c == '{';
    lists += list;
    count += list || c == ',' || c == ':';
  });
  if (count > most) throw InputError(where, "", fmt::format("holds more than {} values", most), kFix);
  if (lists > most_lists)
    throw InputError(where, "", fmt::format("holds more than {} lists", most_lists), kFix);
}

}  // namespace mirage
