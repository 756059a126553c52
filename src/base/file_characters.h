// A file's characters in order, a part of them in memory at a time: for readers of files that may be large
// and need not be good.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>

#include "base/open_file.h"

namespace mirage {

class FileCharacters {
 public:
  /// At the first character behind a byte order mark. InputError as OpenFile, for UTF-16, and, then or while
  /// it is read, if the file holds more than `most` bytes.
  explicit FileCharacters(const std::filesystem::path& file,
                          std::uintmax_t most = std::numeric_limits<std::uintmax_t>::max());

  bool at_end() const { return held_ == 0; }
  /// Of a file that is not at its end.
  char current() const { return part_[at_]; }
  /// Interrupted if a signal has come.
  void next() {
    if (++at_ == held_) fill();
  }
  /// How many come before the current one.
  std::uintmax_t place() const { return before_ + at_; }
  /// How many there are from the current one on, by the file's entry.
  std::uintmax_t left() const { return size_ > place() ? size_ - place() : 0; }

 private:
  void fill();

  OpenFile file_;
  std::uintmax_t most_, size_, before_ = 0;  // of the file; before the part in memory
  std::size_t at_ = 0, held_ = 0;
  char part_[1 << 14];
};

}  // namespace mirage
