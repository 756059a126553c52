#include "exchange/folder_files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "base/error.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

const char* kCheckPath = "check the path and its permissions";
const char* kPutBeside = "put it beside the file that names it";

/// The first `most` bytes of a regular file, opened without following a link at its end and without waiting.
std::string read_regular_file(const fs::path& file, std::size_t most) {
  const int handle = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC);
  struct stat about {};
  if (handle < 0 || ::fstat(handle, &about) != 0 || !S_ISREG(about.st_mode)) {
    const std::string reason = handle < 0 ? std::strerror(errno) : "is no regular file";
    if (handle >= 0) ::close(handle);
    throw InputError(file.string(), "", reason, kCheckPath);
  }
  std::string bytes(std::min(most, static_cast<std::size_t>(about.st_size)), '\0');
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::read(handle, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    done += static_cast<std::size_t>(n);
  }
  const int reason = errno;
  ::close(handle);
  if (done < bytes.size()) throw InputError(file.string(), "", std::strerror(reason), kCheckPath);
  return bytes;
}

}  // namespace

FolderFiles::FolderFiles(const fs::path& file) : given_(file) {
  std::error_code error;
  file_ = fs::canonical(file, error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
  if (!fs::is_regular_file(file_, error))
    throw InputError(file.string(), "", "is no regular file", "give the mesh or scene as a file");
  // Of the path as given: a link to a file elsewhere stands for a file in the link's own folder.
  folder_ = fs::canonical(fs::absolute(file).parent_path(), error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
}

fs::path FolderFiles::find(const std::string& name, const std::string& field) const {
  const auto bad = [&](const char* problem) {
    return InputError(given_.string(), field, problem, kPutBeside);
  };
  if (name.empty() || name.find('\0') != std::string::npos) throw bad("names no file");
  std::error_code error;
  const fs::path path = fs::canonical(folder_ / name, error);  // an absolute name replaces the folder
  const bool inside =
      !error &&
      std::mismatch(folder_.begin(), folder_.end(), path.begin(), path.end()).first == folder_.end();
  // One answer for both: whether a file exists elsewhere is no business of the naming file's author.
  if (!inside) throw bad("names a file that is not in its folder");
  if (!fs::is_regular_file(path, error)) throw bad("names something that is no regular file");
  return path;
}

std::string FolderFiles::read(const std::string& name, const std::string& field, std::size_t most) const {
  const fs::path path = find(name, field);
  try {
    return read_regular_file(path, most);
  } catch (const InputError&) {
    throw InputError(given_.string(), field, "names a file that cannot be read", "check its permissions");
  }
}

std::string lower_extension(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return extension;
}

std::optional<std::string> percent_decoded(const std::string& uri) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const char lower = static_cast<char>(c | 0x20);
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
  };
  std::string text;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      text.push_back(uri[i]);
      continue;
    }
    if (i + 2 >= uri.size()) return std::nullopt;
    const int high = digit(uri[i + 1]), low = digit(uri[i + 2]);
    if (high < 0 || low < 0 || high + low == 0) return std::nullopt;
    text.push_back(static_cast<char>(16 * high + low));
    i += 2;
  }
  return text;
}

}  // namespace mirage
