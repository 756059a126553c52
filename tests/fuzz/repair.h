// Mutations of containers that set sizes and checksums right: after a blind mutation the first check would
// refuse the file, and no later code would be reached.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>

namespace mirage::fuzz {

/// Changes `size` bytes in place, up to `most`; returns the new size.
using Mutate = std::function<std::size_t(std::uint8_t* bytes, std::size_t size, std::size_t most)>;

/// Mutates a PNG and rewrites the checksum of every chunk. In 15 of 16 its header claims at most 255 × 255
/// pixels: allocating millions took nine tenths of the time.
std::string mutate_png(std::string file, std::size_t most, unsigned seed, const Mutate& mutate);
/// Mutates either the JSON or the binary chunk of a .glb and rewrites the lengths.
std::string mutate_glb(std::string file, std::size_t most, unsigned seed, const Mutate& mutate);

}  // namespace mirage::fuzz
