// Bytes as UTF-8 (RFC 3629).
#pragma once

#include <charconv>
#include <cstddef>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

namespace mirage {

/// One character of a text.
struct Utf8Character {
  std::size_t bytes = 0;  ///< 1 to 4; 0: the bytes are not UTF-8
  char32_t point = 0;     ///< its number in Unicode
};
/// The first character of `bytes`, which must not be empty. Overlong forms, surrogates and points above
/// U+10FFFF are not UTF-8.
Utf8Character first_character(std::string_view bytes);

// Names of files and folders as text. A name is bytes: any but '/' and NUL. JSON, terminals and Python want
// UTF-8 without control characters, so such bytes are written as "\xHH".

/// For messages: bytes that are not UTF-8 and control characters as "\xHH", the rest as it is.
std::string printable(std::string_view bytes);

/// For files that are read again: as printable, and a backslash is doubled, so unescape_name restores the
/// bytes.
std::string escape_name(std::string_view bytes);
/// The name that escape_name wrote. Anything else after a backslash stays as it is.
std::string unescape_name(std::string_view text);

/// A frame's name: no separator, not "." or "..", and short enough that files can be named after it.
inline constexpr std::size_t kMaxFrameIdLength = 160;
/// Why `id` cannot be a frame's name; empty if it can.
std::string frame_id_problem(std::string_view id);

/// The parts between any of `separators`; none is empty.
std::vector<std::string_view> split(std::string_view text, std::string_view separators);

/// The number that the whole text spells, as std::from_chars reads it. Empty for other text and for numbers
/// outside of T's range. `plus`: "+1" is 1.
template <class T>
std::optional<T> try_parse_number(std::string_view text, bool plus = false) {
  if (plus && text.starts_with('+')) text.remove_prefix(1);
  T value{};
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  return error == std::errc() && stop == end ? std::optional(value) : std::nullopt;
}

/// The value as text; strings that are no UTF-8 are printable() in it.
std::string json_text(const nlohmann::json& value, int indent = -1);

}  // namespace mirage
