#include "base/folder_lock.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <ctime>
#include <mutex>
#include <set>
#include <string>
#include <string_view>

#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kName = ".mirage-lock";

std::mutex held_mutex;
std::set<fs::path> held;  ///< by this process

std::string own_words() {
  std::array<char, 256> host{};
  gethostname(host.data(), host.size() - 1);
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
  return fmt::format("process {} on {} since {}", getpid(), host.data(), text.data());
}

/// What the lock's file says, of which somebody else may have written anything.
std::string holder(int descriptor) {
  std::array<char, 512> text{};
  const ssize_t size = ::pread(descriptor, text.data(), text.size(), 0);
  std::string words(text.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
  while (!words.empty() && words.back() == '\n') words.pop_back();
  return words.empty() ? "another process" : printable(words);
}

/// Whether the file is still the one by that name: its holder removes it.
bool is_at(const fs::path& file, int descriptor) {
  struct stat opened {
  }, named{};
  return ::fstat(descriptor, &opened) == 0 && ::lstat(file.c_str(), &named) == 0 &&
         opened.st_ino == named.st_ino && opened.st_dev == named.st_dev;
}

/// Whether no process of that number lives, or with `own` only this one.
bool is_gone(std::string_view digits, bool own) {
  pid_t process = 0;
  const auto [end, problem] = std::from_chars(digits.data(), digits.data() + digits.size(), process);
  if (problem != std::errc() || end != digits.data() + digits.size() || process <= 0) return false;
  return (own && process == getpid()) || (::kill(process, 0) != 0 && errno == ESRCH);
}

bool is_stale(std::string_view name, bool own) {
  constexpr std::string_view ending = ".tmp";
  if (!name.ends_with(ending)) return false;
  name.remove_suffix(ending.size());
  const auto mark = name.rfind(kTemporaryMark);
  return mark != std::string_view::npos && is_gone(name.substr(mark + kTemporaryMark.size()), own);
}

}  // namespace

FolderLock::FolderLock(const fs::path& folder, int levels) {
  std::error_code unknown;
  const fs::path key = fs::weakly_canonical(folder, unknown);
  {
    const std::lock_guard lock(held_mutex);
    if (!held.insert(key).second) return;
    key_ = key;
  }
  const auto release = [&] {
    const std::lock_guard lock(held_mutex);
    held.erase(key_);
  };
  file_ = folder / kName;
  while (true) {
    descriptor_ = ::open(file_.c_str(), O_CREAT | O_RDWR | O_CLOEXEC | O_NOFOLLOW, 0644);
    if (descriptor_ < 0 && errno == EACCES)  // another user's
      descriptor_ = ::open(file_.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (descriptor_ < 0) break;  // what is wrong with the folder shows when the result is written
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      const int reason = errno;
      const std::string who = holder(descriptor_);
      ::close(descriptor_);
      descriptor_ = -1;
      if (reason != EWOULDBLOCK) break;  // no locks on this file system
      release();
      throw FolderInUse(folder.string(), "is in use by " + who,
                        "wait for it to end, stop it, or choose another --out folder");
    }
    if (is_at(file_, descriptor_)) break;
    ::close(descriptor_);  // its holder removed it meanwhile: take the new one
  }
  if (descriptor_ >= 0) {
    const std::string words = own_words() + "\n";
    if (::ftruncate(descriptor_, 0) != 0 || ::pwrite(descriptor_, words.data(), words.size(), 0) < 0)
      spdlog::debug("{}: cannot be written", file_.string());  // a full disk: the lock holds all the same
  }
  remove_stale_files(folder, true, levels);
}

FolderLock::~FolderLock() {
  if (key_.empty()) return;
  if (descriptor_ >= 0) {
    ::unlink(file_.c_str());  // before the lock goes: afterwards it may be another's
    ::close(descriptor_);
  }
  const std::lock_guard lock(held_mutex);
  held.erase(key_);
}

void remove_stale_files(const fs::path& folder, bool own, int levels) {
  std::error_code error;
  std::size_t removed = 0;
  for (fs::recursive_directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry.depth() >= levels) entry.disable_recursion_pending();
    std::error_code gone;
    if (!is_stale(entry->path().filename().string(), own) || entry->is_symlink(gone) ||
        !entry->is_regular_file(gone))
      continue;
    if (fs::remove(entry->path(), gone)) ++removed;
  }
  if (removed > 0)
    spdlog::info("{}: removed {} temporary {} of processes that died", folder.string(), removed,
                 removed == 1 ? "file" : "files");
}

}  // namespace mirage
