// A file's first bytes, so that one of another kind is refused before all of it is in memory.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

namespace mirage {

/// The first `most` bytes, or all of a shorter file. InputError as read_file's.
std::string read_head(const std::filesystem::path& path, std::size_t most);

/// Whether the file begins with these bytes.
inline bool begins_with(const std::filesystem::path& path, std::string_view bytes) {
  return read_head(path, bytes.size()) == bytes;
}

}  // namespace mirage
