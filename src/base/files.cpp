#include "base/files.h"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <mutex>
#include <set>

#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

/// Ends the name of a temporary file, before its process's number and ".tmp".
constexpr std::string_view kTemporaryMark = ".mirage-";

/// The temporary file that becomes `path` once it is complete.
fs::path temporary_sibling(const fs::path& path) {
  return path.string() + fmt::format("{}{}.tmp", kTemporaryMark, getpid());
}

}  // namespace

OpenFile::OpenFile(fs::path path) : path_(std::move(path)) {
  std::error_code ignored;  // a path that leads nowhere fails below, with its reason
  if (fs::is_directory(path_, ignored))
    throw InputError(path_.string(), "", "is a folder, not a file", "give the file inside it");
  // A pipe has no end to wait for, and a device no end at all.
  if (fs::exists(path_, ignored) && !fs::is_regular_file(path_, ignored))
    throw InputError(path_.string(), "", "is not a regular file", "give a file, not a pipe or a device");
  // Not by a stream: to that a disk that fails is the end of the file.
  file_ = ::open(path_.c_str(), O_RDONLY | O_CLOEXEC);
  if (file_ < 0) fail("");
}

OpenFile::~OpenFile() {
  if (file_ >= 0) ::close(file_);
}

std::uintmax_t OpenFile::size() const {
  struct stat about;
  return ::fstat(file_, &about) == 0 && about.st_size > 0 ? static_cast<std::uintmax_t>(about.st_size) : 0;
}

void OpenFile::check(std::uintmax_t bytes, std::uintmax_t most) const {
  if (bytes > most)
    throw InputError(path_.string(), "", fmt::format("is larger than {} bytes, which no such file is", most),
                     "give the file that is meant");
}

std::size_t OpenFile::read(char* to, std::size_t size) const {
  for (;;) {
    const ssize_t got = ::read(file_, to, size);
    if (got >= 0) return as_size(got);
    if (errno != EINTR) fail("cannot be read to its end: ");
  }
}

void OpenFile::fail(const char* what) const {
  const int reason = errno;
  throw InputError(path_.string(), "", what + std::string(std::strerror(reason)), fix_for(reason));
}

std::string read_file(const fs::path& path, std::uintmax_t most) {
  const OpenFile file(path);
  const std::uintmax_t size_on_disk = file.size();
  file.check(size_on_disk, most);
  std::string bytes(size_on_disk > 0 ? size_on_disk + 1 : 4096, '\0');  // one more: to see the end
  std::size_t size = 0;
  for (std::size_t got = 1; got != 0; size += got) {
    file.check(size, most);
    if (size == bytes.size())
      bytes.resize(2 * size);  // it grows, or is one of the system's that tell no size
    got = file.read(bytes.data() + size, bytes.size() - size);
  }
  bytes.resize(size);
  return bytes;
}

std::size_t byte_order_mark(std::string_view head, const std::string& where) {
  if (head.starts_with("\xff\xfe") || head.starts_with("\xfe\xff"))
    throw InputError(where, "byte 0", "the text is in UTF-16", "save it as UTF-8");
  return head.starts_with("\xef\xbb\xbf") ? 3 : 0;
}

std::string read_text(const fs::path& path, std::uintmax_t most) {
  std::string text = read_file(path, most);
  text.erase(0, byte_order_mark(text, path.string()));
  return text;
}

std::string read_head(const fs::path& path, std::size_t most) {
  const OpenFile file(path);
  const std::uintmax_t size_on_disk = file.size();
  most = size_on_disk > 0 ? as_size(std::min<std::uintmax_t>(most, size_on_disk)) : most;
  std::string bytes(most, '\0');
  std::size_t size = 0;
  for (std::size_t got = 1; got != 0 && size < most; size += got)
    got = file.read(bytes.data() + size, most - size);
  bytes.resize(size);
  return bytes;
}

std::string content_hash(std::string_view bytes) {
  return fmt::format("{:016x}", fnv1a(bytes));
}

std::string file_hash(const fs::path& path, std::uintmax_t most) {
  constexpr std::uintmax_t kLarge = 1 << 26;  // bytes that take a tenth of a second
  const OpenFile file(path);
  file.check(file.size(), most);
  std::string part(1 << 16, '\0');
  std::uint64_t hash = fnv1a("");
  std::uintmax_t done = 0;
  while (const std::size_t size = file.read(part.data(), part.size())) {
    hash = fnv1a(std::string_view(part).substr(0, size), hash);
    file.check(done += size, most);
    if (done > kLarge) throw_if_interrupted("what was finished is kept");
  }
  return fmt::format("{:016x}", hash);
}

void make_output_folder(const fs::path& folder) {
  if (folder.empty()) throw InputError("--out", "", "names no folder", "give the folder for what is made");
  std::error_code error;
  fs::create_directories(folder, error);
  const auto fail = [&](const std::error_code& why) {
    throw Failure(folder.string(), why.message(), fix_for(why.value()) + ", or choose another --out folder");
  };
  if (error) fail(error);
  // Root passes access() on read-only mounts' modes but not on the mount itself: try a real file.
  const fs::path probe = temporary_sibling(folder / ".probe");
  const int file = ::open(probe.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
  if (file < 0) fail({errno, std::generic_category()});
  ::close(file);
  fs::remove(probe, error);
}

std::string fix_for(int error) {
  switch (error) {
    case ENOSPC:
      return "the disk is full: free some space";
    case EDQUOT:
      return "the user's quota is used up: free some space";
    case EFBIG:
      return "raise the limit on the size of files (ulimit -f)";
    case EROFS:
      return "the file system is read-only: choose another folder";
    case EACCES:
    case EPERM:
      return "check the permissions of the file and its folders";
    case ENAMETOOLONG:
      return "use a shorter name";
    case ENOENT:
      return "check the path";
    case ENOTDIR:
    case EEXIST:
      return "a file stands where a folder should be: choose another path";
    case EISDIR:
      return "a folder stands where the file should be: remove it or choose another path";
    case ELOOP:
      return "a symbolic link leads to itself: check the path";
    case EMFILE:
    case ENFILE:
      return "raise the limit on open files (ulimit -n)";
    case EIO:
      return "the disk or its connection fails: check the system's log";
    case ENOMEM:
      return "free some memory";
    default:
      return "check the path and the disk";
  }
}

namespace {

/// Waits until a file's content, or a folder's list of names, is on the disk: a rename alone can outrun the
/// bytes, and be lost itself. Files that cannot be opened or synchronised (EINVAL: pipes, some network disks)
/// are skipped.
void sync(const fs::path& path) {
  const int handle = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (handle < 0) return;
  const int reason = ::fsync(handle) == 0 ? 0 : errno;
  ::close(handle);
  if (reason != 0 && reason != EINVAL && reason != EROFS)
    throw Failure(path.string(), fmt::format("cannot be written ({})", std::strerror(reason)),
                  fix_for(reason));
}

void rename_into_place(const fs::path& temporary, const fs::path& path) {
  std::error_code error;
  fs::rename(temporary, path, error);
  if (error) {
    ::unlink(temporary.c_str());  // nobody comes back for it
    throw Failure(path.string(), error.message(), fix_for(error.value()));
  }
  sync(path.has_parent_path() ? path.parent_path() : ".");
}

fs::path named_program;

constexpr const char* kName = ".mirage-lock";

std::mutex held_mutex;
std::set<fs::path> locked;  ///< by this process

std::string own_words() {
  std::array<char, 256> host{};
  gethostname(host.data(), host.size() - 1);
  return fmt::format("process {} on {} since {:%FT%TZ}", getpid(), host.data(),
                     fmt::gmtime(std::time(nullptr)));
}

/// The lock file's text, which anybody may have written.
std::string lock_owner(int descriptor) {
  std::array<char, 512> text{};
  const ssize_t size = ::pread(descriptor, text.data(), text.size(), 0);
  std::string words(text.data(), size > 0 ? as_size(size) : 0);
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
  const auto process = try_parse_number<pid_t>(digits);
  if (!process || *process <= 0) return false;
  return (own && *process == getpid()) || (::kill(*process, 0) != 0 && errno == ESRCH);
}

bool is_stale(std::string_view name, bool own) {
  constexpr std::string_view ending = ".tmp";
  if (!name.ends_with(ending)) return false;
  name.remove_suffix(ending.size());
  const auto mark = name.rfind(kTemporaryMark);
  return mark != std::string_view::npos && is_gone(name.substr(mark + kTemporaryMark.size()), own);
}

constexpr const char* kFix = "write the file again with the program that made it";

/// Calls visit(place, character) for each character outside of strings.
template <class Visit>
void for_each_unquoted(std::string_view text, const Visit& visit) {
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c == '\\') ++i;
      quoted = c != '"';
    } else if (c == '"') {
      quoted = true;
    } else {
      visit(i, c);
    }
  }
}

}  // namespace

void replace_file(const fs::path& temporary, const fs::path& path) {
  sync(temporary);  // a plugin has written it
  rename_into_place(temporary, path);
}

void write_file(const fs::path& path, std::string_view bytes) {
  throw_if_loop_stopped();  // OpenCV's loops stop half way too, and say nothing: the bytes may be half a
                            // result
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  if (error) throw Failure(path.parent_path().string(), error.message(), fix_for(error.value()));
  const fs::path temporary = temporary_sibling(path);
  const auto fail = [&](int file, int reason) {
    if (file >= 0) ::close(file);
    ::unlink(temporary.c_str());
    throw Failure(path.string(), fmt::format("cannot be written ({})", std::strerror(reason)),
                  fix_for(reason));
  };
  const int file = ::open(temporary.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0644);
  if (file < 0) fail(file, errno);
  for (std::size_t written = 0; written < bytes.size();) {
    const ssize_t n = ::write(file, bytes.data() + written, bytes.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail(file, errno);
    written += as_size(n);
  }
  if (::fsync(file) != 0 && errno != EINVAL) fail(file, errno);
  if (::close(file) != 0) fail(-1, errno);
  rename_into_place(temporary, path);
}

nlohmann::json read_json(const fs::path& path, std::uintmax_t most, std::size_t most_values) {
  const std::string text = read_text(path, most);
  if (text.size() >= most_values) check_json_values(text, path.string(), most_values);
  return parse_json(text, path.string());
}

nlohmann::json parse_json(std::string_view text, const std::string& where,
                          const nlohmann::json::parser_callback_t& keep) {
  const char* fix = "write the file again with the command that made it";
  check_json_depth(text, where);
  try {
    return nlohmann::json::parse(text, keep);
  } catch (const nlohmann::json::parse_error& error) {
    throw InputError(where, fmt::format("byte {}", error.byte), "not valid JSON", fix);
  } catch (const nlohmann::json::out_of_range&) {
    throw InputError(where, "", "holds a number that is out of range", fix);
  }
}

void write_json(const fs::path& path, const nlohmann::json& value) {
  write_file(path, json_text(value, 2) + "\n");
}

fs::path program_file() {
  return named_program.empty() ? fs::read_symlink("/proc/self/exe") : named_program;
}

void set_program_file(const fs::path& file) {
  named_program = fs::absolute(file);
}

fs::path executable_folder() {
  return program_file().parent_path();
}

fs::path shipped_file(const std::string& relative) {
  if (const char* home = std::getenv("MIRAGE_HOME"); home && fs::exists(fs::path(home) / relative))
    return fs::path(home) / relative;
  if (const fs::path installed = executable_folder().parent_path() / "share/mirage" / relative;
      fs::exists(installed))
    return installed;
  for (fs::path folder = executable_folder();; folder = folder.parent_path()) {
    if (fs::exists(folder / relative)) return folder / relative;
    if (folder == folder.root_path()) break;
  }
  throw InputError(
      relative, "", "not found beside the program",
      "install Mirage again, run the program from its build folder or set MIRAGE_HOME to the sources");
}

FolderLock::FolderLock(const fs::path& folder, int levels) {
  std::error_code unknown;
  const fs::path key = fs::weakly_canonical(folder, unknown);
  {
    const std::lock_guard lock(held_mutex);
    if (!locked.insert(key).second) return;
    key_ = key;
  }
  const auto release = [&] {
    const std::lock_guard lock(held_mutex);
    locked.erase(key_);
  };
  file_ = folder / kName;
  while (true) {
    descriptor_ = ::open(file_.c_str(), O_CREAT | O_RDWR | O_CLOEXEC | O_NOFOLLOW, 0644);
    if (descriptor_ < 0 && errno == EACCES)  // another user's
      descriptor_ = ::open(file_.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (descriptor_ < 0) break;  // what is wrong with the folder shows when the result is written
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      const int reason = errno;
      const std::string who = lock_owner(descriptor_);
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
  locked.erase(key_);
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

void check_json_depth(std::string_view text, const std::string& where, const std::string& field) {
  int depth = 0;
  for_each_unquoted(text, [&](std::size_t i, char c) {
    if (c == '[' || c == '{') {
      if (++depth > kMaxJsonDepth)
        throw InputError(where, field, fmt::format("byte {}: nested deeper than {} levels", i, kMaxJsonDepth),
                         kFix);
    } else if (c == ']' || c == '}') {
      --depth;
    }
  });
}

void check_json_values(std::string_view text, const std::string& where, std::size_t most,
                       std::size_t most_lists) {
  std::size_t count = 1, lists = 0;
  for_each_unquoted(text, [&](std::size_t, char c) {
    const bool list = c == '[' || c == '{';
    lists += list;
    count += list || c == ',' || c == ':';
  });
  if (count > most) throw InputError(where, "", fmt::format("holds more than {} values", most), kFix);
  if (lists > most_lists)
    throw InputError(where, "", fmt::format("holds more than {} lists", most_lists), kFix);
}

FileCharacters::FileCharacters(const std::filesystem::path& file, std::uintmax_t most)
    : file_(file), most_(most), size_(file_.size()) {
  file_.check(size_, most_);
  fill();
  for (std::size_t mark = byte_order_mark({part_, held_}, file.string()); mark > 0; --mark) next();
}

void FileCharacters::fill() {
  throw_if_interrupted("what was finished is kept");
  before_ += held_;
  at_ = 0;
  held_ = file_.read(part_, sizeof part_);
  file_.check(before_ + held_, most_);
}

fs::path built_file(const std::string& relative) {
  const fs::path beside = executable_folder() / relative;
  if (fs::exists(beside)) return beside;
  const fs::path installed = executable_folder().parent_path() / "lib/mirage" / relative;
  return fs::exists(installed) ? installed : beside;
}

}  // namespace mirage
