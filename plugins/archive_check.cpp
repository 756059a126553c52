#include "archive_check.h"

#include <algorithm>
#include <cstring>

namespace mirage {
namespace {

// APPNOTE.TXT of PKWARE, 4.3.12 to 4.3.16 and 4.5.3.
constexpr std::size_t kEnd = 22, kLocator = 20, kEnd64 = 56, kEntry = 46;
constexpr std::uint32_t kInExtra = 0xffffffff;  // the number is in the entry's 64-bit extra field

[[noreturn]] void no_archive() {
  throw std::runtime_error("no archive of LibTorch's writer");
}

/// `count` bytes at `at`, which are there.
std::string_view part(std::string_view file, std::uint64_t at, std::uint64_t count) {
  if (at > file.size() || count > file.size() - at) no_archive();
  return file.substr(at, count);
}

template <class T>
T number(std::string_view file, std::uint64_t at) {
  T value = 0;  // little-endian, as the machines that this runs on
  std::memcpy(&value, part(file, at, sizeof value).data(), sizeof value);
  return value;
}

struct Directory {
  std::uint64_t entries = 0, at = 0;
};

/// By the file's last bytes: a reader that looks for the end backwards, as LibTorch's does, finds these
/// first.
Directory find_directory(std::string_view file) {
  if (file.size() < kEnd) no_archive();
  const std::uint64_t end = file.size() - kEnd;
  if (!file.substr(end).starts_with("PK\5\6") || number<std::uint16_t>(file, end + 20) != 0) no_archive();
  if (end < kLocator || !file.substr(end - kLocator).starts_with("PK\6\7"))
    return {number<std::uint16_t>(file, end + 10), number<std::uint32_t>(file, end + 16)};
  const auto end64 = number<std::uint64_t>(file, end - kLocator + 8);
  const std::string_view record = part(file, end64, kEnd64);
  if (!record.starts_with("PK\6\6")) no_archive();
  return {number<std::uint64_t>(record, 32), number<std::uint64_t>(record, 48)};
}

/// Bytes unpacked, of the entry with this extra field.
std::uint64_t unpacked(std::string_view entry, std::string_view extra) {
  const auto size = number<std::uint32_t>(entry, 24);
  while (size == kInExtra && extra.size() >= 4) {
    const auto bytes = number<std::uint16_t>(extra, 2);
    if (number<std::uint16_t>(extra, 0) == 1) return number<std::uint64_t>(part(extra, 4, bytes), 0);
    extra.remove_prefix(part(extra, 0, 4u + bytes).size());
  }
  return size;
}

std::string in_words(std::uint64_t bytes) {
  return bytes < 10'000'000 ? std::to_string(bytes) + " bytes" : std::to_string(bytes / 1'000'000) + " MB";
}

}  // namespace

std::map<std::string, std::uint64_t, std::less<>> check_archive(std::string_view file) {
  const Directory directory = find_directory(file);
  if (directory.entries > kMostRecords)
    throw ArchiveTooLarge("declares " + std::to_string(directory.entries) + " records");
  const std::uint64_t most = kArchiveGrowth * file.size() + kArchiveSlack;
  std::map<std::string, std::uint64_t, std::less<>> sizes;
  std::uint64_t at = directory.at, all = 0;
  for (std::uint64_t i = 0; i < directory.entries; ++i) {
    const std::string_view entry = part(file, at, kEntry);
    if (!entry.starts_with("PK\1\2")) no_archive();
    const std::uint64_t name = number<std::uint16_t>(entry, 28), extra = number<std::uint16_t>(entry, 30);
    const std::uint64_t size = unpacked(entry, part(file, at + kEntry + name, extra));
    if (size > most - all)
      throw ArchiveTooLarge("declares records of " + in_words(size) + " and more in a file of " +
                            in_words(file.size()));
    all += size;
    std::uint64_t& kept = sizes[std::string(part(file, at + kEntry, name))];
    kept = std::max(kept, size);
    at += kEntry + name + extra + number<std::uint16_t>(entry, 32);
  }
  return sizes;
}

}  // namespace mirage
