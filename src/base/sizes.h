// Signed numbers and enumerators where the standard library takes unsigned ones.
#pragma once

#include <concepts>
#include <cstddef>
#include <type_traits>

namespace mirage {

/// A count, an index or an enumerator as containers take it; `value` is not negative.
template <class I>
requires std::integral<I> || std::is_enum_v<I>
constexpr std::size_t as_size(I value) {
  return static_cast<std::size_t>(value);
}

}  // namespace mirage
