// A regular file that is read in parts (files.cpp).
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>

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

}  // namespace mirage
