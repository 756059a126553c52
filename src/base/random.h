// Counter-based random streams (Philox 4x32-10; Salmon et al., SC 2011), keyed by (seed, purpose, index):
// a value depends on its key and its place in the stream, never on threads or on other streams.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <utility>
#include <vector>

#include "base/sizes.h"

namespace mirage {

// 64-bit FNV-1a: the same on every platform, unlike std::hash. Not cryptographic.

/// `before`: the hash of the preceding bytes, to continue it.
constexpr std::uint64_t fnv1a(std::string_view bytes, std::uint64_t before = 14695981039346656037ull) {
  std::uint64_t value = before;
  for (const char c : bytes) value = (value ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return value;
}

/// One stream of numbers.
class RandomStream {
 public:
  /// `purpose` names what the numbers are for ("vehicle paint"), `index` which of them (frame 17).
  RandomStream(std::uint64_t seed, std::string_view purpose, std::uint64_t index = 0);

  /// Uniform over all 32-bit words.
  std::uint32_t next_u32();
  /// Uniform in [0, 1), 53 bits.
  double uniform();
  /// Uniform in [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// Uniform in {0, …, n − 1}; n ≥ 1.
  int below(int n) { return static_cast<int>(uniform() * n); }
  /// Standard normal (Box–Muller).
  double normal();

 private:
  std::uint32_t key_[2];
  std::uint32_t counter_[4];
  std::uint32_t block_[4] = {};
  int used_ = 4;
};

/// Fisher and Yates's shuffle (Durstenfeld, CACM 1964) from the last place down: the same with every standard
/// library, unlike std::shuffle.
template <class T>
void shuffle(std::vector<T>& list, RandomStream& random) {
  for (std::size_t i = list.size(); i > 1; --i)
    std::swap(list[i - 1], list[as_size(random.below(static_cast<int>(i)))]);
}

}  // namespace mirage
