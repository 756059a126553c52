#include "base/disk_cache.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <vector>

#include "base/random.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// The head of an entry; key and payload follow.
struct Head {
  char magic[8] = {'M', 'I', 'R', 'C', 'A', 'C', 'H', '1'};
  std::uint64_t key_size = 0, payload_size = 0, payload_hash = 0;
};
static_assert(sizeof(Head) == 32);

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value ? value : "";
}

}  // namespace

DiskCache::DiskCache(fs::path folder, std::uint64_t limit) : folder_(std::move(folder)), limit_(limit) {}

std::unique_ptr<DiskCache> DiskCache::from_environment() {
  const std::string cache = variable("MIRAGE_CACHE"), shared = variable("XDG_CACHE_HOME"),
                    home = variable("HOME");
  fs::path folder;
  if (!cache.empty())
    folder = cache == "off" ? "" : cache;
  else if (!shared.empty())
    folder = fs::path(shared) / "mirage";
  else if (!home.empty())
    folder = fs::path(home) / ".cache" / "mirage";
  return std::make_unique<DiskCache>(folder);
}

fs::path DiskCache::file_of(const std::string& kind, std::string_view key) const {
  return folder_ / kind / (content_hash(key) + ".entry");
}

std::optional<std::string> DiskCache::read(const std::string& kind, std::string_view key) const {
  if (!on()) return std::nullopt;
  const fs::path file = file_of(kind, key);
  std::error_code error;
  if (!fs::is_regular_file(file, error)) {  // a pipe would be waited for
    if (fs::exists(file, error)) report_damaged(kind, key);
    return std::nullopt;
  }
  std::ifstream in(file, std::ios::binary);
  if (!in) return std::nullopt;
  const std::uint64_t size = fs::file_size(file, error);
  Head head;
  const Head expected;
  in.read(reinterpret_cast<char*>(&head), sizeof head);
  const bool whole = in && !error && std::memcmp(head.magic, expected.magic, sizeof head.magic) == 0 &&
                     head.key_size < size && head.payload_size < size &&
                     sizeof head + head.key_size + head.payload_size == size;
  if (!whole) return report_damaged(kind, key), std::nullopt;
  std::string stored_key(head.key_size, '\0'), payload(head.payload_size, '\0');
  in.read(stored_key.data(), static_cast<std::streamsize>(stored_key.size()));
  in.read(payload.data(), static_cast<std::streamsize>(payload.size()));
  if (!in || fnv1a(payload) != head.payload_hash) return report_damaged(kind, key), std::nullopt;
  if (stored_key != key) return std::nullopt;                          // another key of the same hash
  fs::last_write_time(file, fs::file_time_type::clock::now(), error);  // used: the last to go
  return payload;
}

void DiskCache::report_damaged(const std::string& kind, std::string_view key) const {
  if (!warned_.exchange(true))
    spdlog::warn("{}: damaged cache entry, computed anew (others will not be told)",
                 file_of(kind, key).string());
}

void DiskCache::write(const std::string& kind, std::string_view key, std::string_view bytes) {
  if (!on() || !writable_) return;
  Head head;
  head.key_size = key.size();
  head.payload_size = bytes.size();
  head.payload_hash = fnv1a(bytes);
  std::string entry(reinterpret_cast<const char*>(&head), sizeof head);
  entry.reserve(entry.size() + key.size() + bytes.size());
  entry += key;
  entry += bytes;
  try {
    write_file(file_of(kind, key), entry);
  } catch (const std::exception& problem) {
    if (writable_.exchange(false))
      spdlog::warn("nothing more is cached: {} (MIRAGE_CACHE names another folder, or off)", problem.what());
    return;
  }
  const std::lock_guard lock(trimming_);
  unchecked_ += entry.size();
  if (!looked_ || unchecked_ > limit_ / 16) trim();
}

void DiskCache::trim() {
  looked_ = true;
  unchecked_ = 0;
  struct Entry {
    fs::file_time_type used;
    fs::path file;
    std::uint64_t size;
  };
  std::vector<Entry> entries;
  std::uint64_t total = 0;
  std::error_code error;
  for (fs::recursive_directory_iterator entry(folder_, error), end; !error && entry != end;
       entry.increment(error)) {
    std::error_code gone;  // another process may be at it as well
    if (!entry->is_regular_file(gone)) continue;
    const auto used = entry->last_write_time(gone);
    const std::uint64_t size = entry->file_size(gone);
    if (gone) continue;
    // Only what this class writes: the user may have named a folder that holds other things too.
    if (entry->path().filename().string().find(".entry") == std::string::npos) continue;
    entries.push_back({used, entry->path(), size});
    total += size;
  }
  remove_stale_files(folder_);
  if (total <= limit_) return;
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return a.used != b.used ? a.used < b.used : a.file < b.file;
  });
  for (const Entry& oldest : entries) {
    if (total <= limit_ / 8 * 7) break;
    if (fs::remove(oldest.file, error)) total -= oldest.size;
  }
}

}  // namespace mirage
