// Names of files and folders as text. A name is bytes: any but '/' and NUL. JSON, terminals and Python want
// UTF-8 without control characters, so such bytes are written as "\xHH".
#pragma once

#include <cstddef>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace mirage {

/// For messages: bytes that are no UTF-8 and control characters as "\xHH", the rest as it is.
std::string printable(std::string_view bytes);

/// For files that are read again: as printable, and a backslash is doubled, so that unescape_name gives the
/// very bytes back.
std::string escape_name(std::string_view bytes);
/// The name that escape_name wrote. Anything else after a backslash stays as it is.
std::string unescape_name(std::string_view text);

/// A frame's name: no separator, not "." or "..", and short enough that files can be named after it.
inline constexpr std::size_t kLongestFrameId = 160;
/// Why it can't be one; empty if it can.
std::string frame_id_problem(std::string_view id);

/// The value as text; strings that are no UTF-8 are printable() in it.
std::string json_text(const nlohmann::json& value, int indent = -1);

}  // namespace mirage
