#include "base/files.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>

#include "base/error.h"
#include "base/hash.h"
#include "base/parallel.h"

namespace mirage {

namespace fs = std::filesystem;

std::string read_file(const fs::path& path) {
  if (fs::is_directory(path))
    throw InputError(path.string(), "", "is a folder, not a file", "give the file inside it");
  std::ifstream in(path, std::ios::binary);
  if (!in) throw InputError(path.string(), "", std::strerror(errno), "check the path and its permissions");
  std::ostringstream out;
  out << in.rdbuf();
  return std::move(out).str();
}

std::string content_hash(std::string_view bytes) {
  return fmt::format("{:016x}", fnv1a(bytes));
}

void make_output_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw Failure(folder.string(), error.message(), "choose another --out folder");
  // Root passes access() on read-only mounts' modes but not on the mount itself: try a real file.
  const fs::path probe = folder / fmt::format(".probe-{}", getpid());
  const int file = ::open(probe.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
  if (file < 0) throw Failure(folder.string(), std::strerror(errno), "choose another --out folder");
  ::close(file);
  fs::remove(probe, error);
}

namespace {

/// Waits until a file's content, or a folder's list of names, is on the disk: a rename alone can outrun the
/// bytes, and be lost itself. What cannot be opened or has nothing to wait for (EINVAL: pipes, some network
/// disks) passes.
void sync(const fs::path& path) {
  const int handle = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (handle < 0) return;
  const int reason = ::fsync(handle) == 0 ? 0 : errno;
  ::close(handle);
  if (reason != 0 && reason != EINVAL && reason != EROFS)
    throw Failure(path.string(), fmt::format("cannot be written ({})", std::strerror(reason)),
                  "free some space or choose another folder");
}

}  // namespace

void replace_file(const fs::path& temporary, const fs::path& path) {
  sync(temporary);  // a plugin may have written it
  std::error_code error;
  fs::rename(temporary, path, error);
  if (error) throw Failure(path.string(), error.message(), "check the folder's permissions");
  sync(path.has_parent_path() ? path.parent_path() : ".");
}

void write_file(const fs::path& path, std::string_view bytes) {
  throw_if_loop_stopped();  // OpenCV's loops stop half way too, and say nothing: the bytes may be half a
                            // result
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  if (error) throw Failure(path.parent_path().string(), error.message(), "choose another folder");
  const fs::path temporary = path.string() + fmt::format(".{}.tmp", getpid());
  const auto fail = [&](int file, int reason) {
    if (file >= 0) ::close(file);
    ::unlink(temporary.c_str());
    throw Failure(path.string(), fmt::format("cannot be written ({})", std::strerror(reason)),
                  "free some space or choose another folder");
  };
  const int file = ::open(temporary.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0644);
  if (file < 0) fail(file, errno);
  for (std::size_t written = 0; written < bytes.size();) {
    const ssize_t n = ::write(file, bytes.data() + written, bytes.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail(file, errno);
    written += static_cast<std::size_t>(n);
  }
  if (::fsync(file) != 0 && errno != EINVAL) fail(file, errno);
  if (::close(file) != 0) fail(-1, errno);
  replace_file(temporary, path);
}

nlohmann::json read_json(const fs::path& path) {
  try {
    return nlohmann::json::parse(read_file(path));
  } catch (const nlohmann::json::parse_error& error) {
    throw InputError(path.string(), fmt::format("byte {}", error.byte), "not valid JSON",
                     "write the file again with the command that made it");
  }
}

void write_json(const fs::path& path, const nlohmann::json& value) {
  write_file(path, value.dump(2) + "\n");
}

fs::path executable_folder() {
  return fs::read_symlink("/proc/self/exe").parent_path();
}

fs::path shipped_file(const std::string& relative) {
  if (const char* home = std::getenv("MIRAGE_HOME"); home && fs::exists(fs::path(home) / relative))
    return fs::path(home) / relative;
  for (fs::path folder = executable_folder();; folder = folder.parent_path()) {
    if (fs::exists(folder / relative)) return folder / relative;
    if (folder == folder.root_path()) break;
  }
  throw InputError(relative, "", "not found beside the program",
                   "set MIRAGE_HOME to Mirage's source folder or run the program from its build folder");
}

}  // namespace mirage
