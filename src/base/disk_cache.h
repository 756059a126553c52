// A disk cache of results that are costly to compute, keyed by their inputs. An entry holds its whole key and
// a checksum, so a truncated, damaged or wrong file is never used: the result is computed again. A problem
// with the folder costs time but never fails a run.
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

/// A folder of results by key, of limited size. Several threads and processes may use it at once.
class DiskCache {
 public:
  /// Bytes that a cache keeps unless told otherwise: 20 GiB.
  static constexpr std::uint64_t kLimit = 20ull << 30;

  /// `folder` is made at the first write; an empty one turns the cache off. Above `limit` bytes, the least
  /// recently used entries are removed.
  explicit DiskCache(std::filesystem::path folder, std::uint64_t limit = kLimit);
  /// The cache in folder MIRAGE_CACHE ("off": none), else in $XDG_CACHE_HOME/mirage, else in ~/.cache/mirage.
  static std::unique_ptr<DiskCache> from_environment();

  /// Whether there is a folder.
  bool on() const { return !folder_.empty(); }
  /// The stored bytes of the key, among entries of this `kind` (a folder's name). Empty if there are none or,
  /// after a warning, if the entry is damaged.
  std::optional<std::string> read(const std::string& kind, std::string_view key) const;
  /// Stores the bytes atomically. If that fails, it warns and stores nothing more.
  void write(const std::string& kind, std::string_view key, std::string_view bytes);
  /// Warns, once, of a damaged entry, such as one that its reader cannot parse.
  void report_damaged(const std::string& kind, std::string_view key) const;

 private:
  std::filesystem::path file_of(const std::string& kind, std::string_view key) const;
  void trim();

  std::filesystem::path folder_;
  std::uint64_t limit_;
  std::atomic<bool> writable_ = true;
  mutable std::atomic<bool> warned_ = false;
  std::mutex trimming_;
  std::uint64_t unchecked_ = 0;  ///< bytes written since the folder's size was measured
  bool looked_ = false;
};

// JSON files that a command keeps for its next run, under a key made from their inputs.

/// The fix that errors name for a damaged file.
inline constexpr const char* kKeptAgain = "delete the file";

/// The result of read(fields) on the file, an std::optional. Empty if the file is missing, has another `key`,
/// or is damaged; damage logs a warning.
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
