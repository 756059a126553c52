// Bytes as UTF-8 (RFC 3629).
#pragma once

#include <cstddef>
#include <string_view>

namespace mirage {

/// One character of a text.
struct Utf8Character {
  std::size_t bytes = 0;  ///< 1 to 4; 0: what is there is no UTF-8
  char32_t point = 0;     ///< its number in Unicode
};
/// The one at the head of `bytes`, which are not empty. Overlong forms, surrogates and what lies past
/// U+10FFFF are none.
Utf8Character first_character(std::string_view bytes);

}  // namespace mirage
