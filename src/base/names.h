// Bytes as UTF-8 (RFC 3629).
#pragma once

#include <cstddef>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// One character of a text.
struct Utf8Character {
  std::size_t bytes = 0;  ///< 1 to 4; 0: what is there is no UTF-8
  char32_t point = 0;     ///< its number in Unicode
};
/// The one at the head of `bytes`, which are not empty. Overlong forms, surrogates and what lies past
/// U+10FFFF are none.
Utf8Character first_character(std::string_view bytes);

// Names of files and folders as text. A name is bytes: any but '/' and NUL. JSON, terminals and Python want
// UTF-8 without control characters, so such bytes are written as "\xHH".

/// For messages: bytes that are no UTF-8 and control characters as "\xHH", the rest as it is.
std::string printable(std::string_view bytes);

/// For files that are read again: as printable, and a backslash is doubled, so that unescape_name gives the
/// very bytes back.
std::string escape_name(std::string_view bytes);
/// The name that escape_name wrote. Anything else after a backslash stays as it is.
std::string unescape_name(std::string_view text);

/// A frame's name: no separator, not "." or "..", and short enough that files can be named after it.
inline constexpr std::size_t kMaxFrameIdLength = 160;
/// Why it can't be one; empty if it can.
std::string frame_id_problem(std::string_view id);

/// The parts between any of `separators`; none is empty.
std::vector<std::string_view> split(std::string_view text, std::string_view separators);

/// The value as text; strings that are no UTF-8 are printable() in it.
std::string json_text(const nlohmann::json& value, int indent = -1);

}  // namespace mirage
