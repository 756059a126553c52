// 64-bit FNV-1a: the same on every platform, unlike std::hash. Tells contents apart; no protection against
// malice.
#pragma once

#include <cstdint>
#include <string_view>

namespace mirage {

/// `before`: the hash of what stands before the bytes, if they go on.
constexpr std::uint64_t fnv1a(std::string_view bytes, std::uint64_t before = 14695981039346656037ull) {
  std::uint64_t value = before;
  for (const char c : bytes) value = (value ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return value;
}

}  // namespace mirage
