// Results that are costly to compute, kept on disk under what they were computed from. An entry holds its
// whole key and a checksum, so a truncated, damaged or mistaken file is never taken for a result: it is
// computed again. Trouble with the folder costs time, never a run.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"

namespace mirage {

/// A folder of results by key, of limited size. For several threads and processes at once.
class DiskCache {
 public:
  /// Bytes that a cache keeps unless told otherwise: 20 GiB.
  static constexpr std::uint64_t kLimit = 20ull << 30;

  /// In `folder` (made at the first write; empty: off). `limit`, bytes: where it is passed, what was not used
  /// for longest goes.
  explicit DiskCache(std::filesystem::path folder, std::uint64_t limit = kLimit);
  /// Where MIRAGE_CACHE says ("off": nowhere), else $XDG_CACHE_HOME/mirage, else ~/.cache/mirage.
  static std::unique_ptr<DiskCache> from_environment();

  /// Whether there is a folder.
  bool on() const { return !folder_.empty(); }
  /// What was kept for the key, among entries of this `kind` (a folder's name). None if there is nothing or,
  /// after a warning, if the entry is damaged.
  std::optional<std::string> read(const std::string& kind, std::string_view key) const;
  /// Keeps it, atomically. Where that fails nothing more is kept, after a warning.
  void write(const std::string& kind, std::string_view key, std::string_view bytes);
  /// An entry whose bytes make no sense to their reader counts as damaged.
  void report_damaged(const std::string& kind, std::string_view key) const;

 private:
  std::filesystem::path file_of(const std::string& kind, std::string_view key) const;
  void trim();

  std::filesystem::path folder_;
  std::uint64_t limit_;
  std::atomic<bool> writable_ = true;
  mutable std::atomic<bool> warned_ = false;
  std::mutex trimming_;
  std::uint64_t unchecked_ = 0;  ///< bytes written since the folder's size was looked at
  bool looked_ = false;
};

// JSON files that a command keeps for its next run, under a key of what they are made of.

/// How a damaged one is mended.
inline constexpr const char* kKeptAgain = "delete the file";

/// The result of read(fields) on the file, an std::optional. Empty if the file is missing, has another `key`,
/// or is damaged, of which a warning is logged.
template <class Read>
std::invoke_result_t<Read, const JsonFields&> read_cached(const std::filesystem::path& file,
                                                          const std::string& key, const Read& read) {
  if (file.empty() || !std::filesystem::exists(file)) return std::nullopt;
  try {
    const nlohmann::json stored = read_json(file);
    const JsonFields fields(file, stored, kKeptAgain);
    if (fields.text("key") != key) return std::nullopt;
    return read(fields);
  } catch (const InputError& damaged) {
    spdlog::warn("{}", damaged.what());
    return std::nullopt;
  }
}

}  // namespace mirage
