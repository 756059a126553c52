// What toml++ is given to read, and how its complaints are passed on.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace mirage {

/// A TOML text that means the same and is ASCII: letters beyond it become escapes in strings (literal ones
/// become basic ones) and '?' in comments; lines keep their numbers. toml++ 3.3 (mended after 3.4) runs into
/// __builtin_unreachable at such letters (is_non_ascii_horizontal_whitespace, 3019 of them): where they are
/// refused, but also at the head of a line after a line-ending backslash, where they belong.
/// InputError, naming `name` and the line, for bytes that are no UTF-8 and for such letters elsewhere.
std::string toml_in_ascii(std::string_view text, const std::string& name);

/// Throws the InputError of a syntax error.
[[noreturn]] void refuse_toml(const std::string& name, std::size_t line, const std::string& problem);

}  // namespace mirage
