// What a weights file says of its own size, before LibTorch's reader makes room for that: a zip file's
// directory names the size of every record, and a few bytes can name any. Without LibTorch, so that a fuzzer
// can do it quickly.
#pragma once

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>

namespace mirage {

/// Records may be this many times the file, and kArchiveSlack bytes more: LibTorch packs nothing but the text
/// of classes, five to one.
inline constexpr std::uint64_t kArchiveGrowth = 4, kArchiveSlack = 1 << 16;
/// Records at most: a network has some for each of its tensors.
inline constexpr std::uint64_t kMostRecords = 100'000;

/// A file that declares more than it can hold.
class ArchiveTooLarge : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The size of every record, bytes unpacked, by its whole name; of two of the same name the larger.
/// ArchiveTooLarge, with both sizes in its words, where all of them together are more than kArchiveGrowth
/// times the file and kArchiveSlack, or more than kMostRecords; std::runtime_error where the file does not
/// end as LibTorch's writer ends one, or its directory leaves the file.
std::map<std::string, std::uint64_t, std::less<>> check_archive(std::string_view file);

}  // namespace mirage
