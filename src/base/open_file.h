// A regular file that is read in parts (files.cpp).
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

namespace mirage {

/// InputError, by the constructor too, for what cannot be read: a folder, a pipe, a device, a disk that
/// fails.
class OpenFile {
 public:
  explicit OpenFile(std::filesystem::path path);
  ~OpenFile();
  OpenFile(const OpenFile&) = delete;
  OpenFile& operator=(const OpenFile&) = delete;

  /// Bytes by its entry; 0: one of the system's that tell no size.
  std::uintmax_t size() const;
  /// InputError if `bytes` are more than `most`.
  void check(std::uintmax_t bytes, std::uintmax_t most) const;
  /// Reads up to `size` bytes; 0 at the end.
  std::size_t read(char* to, std::size_t size) const;

 private:
  [[noreturn]] void fail(const char* what) const;

  std::filesystem::path path_;
  int file_ = -1;
};

// A file's first bytes, so that one of another kind is refused before all of it is in memory.

/// The first `most` bytes, or all of a shorter file. InputError as read_file's.
std::string read_head(const std::filesystem::path& path, std::size_t most);

/// Whether the file begins with these bytes.
inline bool begins_with(const std::filesystem::path& path, std::string_view bytes) {
  return read_head(path, bytes.size()) == bytes;
}

}  // namespace mirage
