// Containers whose sizes and check sums are set right after a mutation: a blind one would be refused at the
// first look, and nothing behind it reached.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>

namespace mirage::fuzz {

/// Changes `size` bytes in place, up to `most`; the new size.
using Mutate = std::function<std::size_t(std::uint8_t* bytes, std::size_t size, std::size_t most)>;

/// Mutates a PNG and writes the check sum of every chunk anew. In 15 of 16 its header claims at most 255 ×
/// 255 pixels: setting aside millions took nine tenths of the time.
std::string mutate_png(std::string file, std::size_t most, unsigned seed, const Mutate& mutate);
/// Mutates either the JSON or the binary chunk of a .glb and writes the lengths anew.
std::string mutate_glb(std::string file, std::size_t most, unsigned seed, const Mutate& mutate);

}  // namespace mirage::fuzz
