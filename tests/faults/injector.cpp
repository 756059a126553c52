// A disk that fails: LD_PRELOAD=libmirage_faults.so makes the n-th call of a kind fail, for files under one
// folder.
//
//     MIRAGE_FAULT=write      write, pwrite, writev and fwrite; also: fsync, rename, open (for writing: open,
//                             openat, creat and fopen), read (read, pread and fread) and short (the same, of
//                             which only half is read at first: no error)
//     MIRAGE_FAULT_UNDER=DIR  only files in it count
//     MIRAGE_FAULT_AT=7       the seventh fails (from 1); 0: none, only count
//     MIRAGE_FAULT_ERROR=28   with this errno (ENOSPC); "kill": the process is killed before the call
//     MIRAGE_FAULT_LASTING=1  and every later one of the kind too, as on a disk that stays full
//     MIRAGE_FAULT_COUNT=FILE where the number of calls is written when the process ends
//     MIRAGE_FAULT_IN=NAME    only processes of that name count (default: all, each by itself)
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <cstring>
#include <string>

namespace {

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value ? value : "";
}

struct Plan {
  std::string kind = variable("MIRAGE_FAULT"), under = variable("MIRAGE_FAULT_UNDER"),
              error = variable("MIRAGE_FAULT_ERROR"), count_file = variable("MIRAGE_FAULT_COUNT");
  long at = std::atol(variable("MIRAGE_FAULT_AT").c_str());
  bool lasting = variable("MIRAGE_FAULT_LASTING") == "1";
  const std::string program = variable("MIRAGE_FAULT_IN");
  bool here = program.empty() || program == program_invocation_short_name;
  std::atomic<long> calls{0};
  ~Plan() {
    if (count_file.empty() || !here) return;
    const int file = static_cast<int>(::syscall(SYS_openat, AT_FDCWD, count_file.c_str(),
                                                O_CREAT | O_TRUNC | O_WRONLY, 0600));  // uncounted
    const std::string text = std::to_string(calls.load());
    if (file >= 0) ::syscall(SYS_write, file, text.data(), text.size());
  }
};

Plan& plan() {
  static Plan made;
  return made;
}

bool counts(const char* kind, const std::string& path) {
  const Plan& p = plan();
  return p.here && p.kind == kind && !p.under.empty() && path.compare(0, p.under.size(), p.under) == 0;
}

std::string path_of(int file) {
  char link[64], path[PATH_MAX];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t size = ::readlink(link, path, sizeof path);
  return size > 0 ? std::string(path, static_cast<std::size_t>(size)) : "";
}

/// Whether this call fails; errno is set then.
bool fails(const char* kind, const std::string& path) {
  Plan& p = plan();
  if (!counts(kind, path)) return false;
  const long call = ++p.calls;
  if (p.at == 0 || call < p.at || (call > p.at && !p.lasting)) return false;
  if (p.error == "kill") ::kill(::getpid(), SIGKILL);
  errno = std::atoi(p.error.c_str());
  return true;
}

std::string absolute(const char* path, int folder = AT_FDCWD) {
  if (path[0] == '/') return path;
  if (folder != AT_FDCWD) return path_of(folder) + "/" + path;
  char here[PATH_MAX];
  return ::getcwd(here, sizeof here) ? std::string(here) + "/" + path : path;
}

bool writes(int flags) {
  return (flags & O_ACCMODE) != O_RDONLY;
}

bool writes(const char* mode) {
  return mode[0] == 'w' || mode[0] == 'a' || std::strchr(mode, '+');
}

template <class Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

}  // namespace

#define NEXT(name) next<decltype(&::name)>(#name)
// `mode`: what follows the flags of a file that may be made.
#define MODE(flags)                                                                                     \
  va_list rest;                                                                                         \
  va_start(rest, flags);                                                                                \
  const mode_t mode = (flags & O_CREAT) || (flags & O_TMPFILE) == O_TMPFILE ? va_arg(rest, mode_t) : 0; \
  va_end(rest)

extern "C" {

ssize_t write(int file, const void* bytes, size_t size) {
  static const auto real = NEXT(write);
  return fails("write", path_of(file)) ? -1 : real(file, bytes, size);
}

ssize_t pwrite(int file, const void* bytes, size_t size, off_t at) {
  static const auto real = NEXT(pwrite);
  return fails("write", path_of(file)) ? -1 : real(file, bytes, size, at);
}

ssize_t writev(int file, const struct iovec* parts, int count) {
  static const auto real = NEXT(writev);
  return fails("write", path_of(file)) ? -1 : real(file, parts, count);
}

size_t fwrite(const void* bytes, size_t size, size_t count, FILE* stream) {
  static const auto real = NEXT(fwrite);
  return fails("write", path_of(fileno(stream))) ? 0 : real(bytes, size, count, stream);
}

int fsync(int file) {
  static const auto real = NEXT(fsync);
  return fails("fsync", path_of(file)) ? -1 : real(file);
}

int fdatasync(int file) {
  static const auto real = NEXT(fdatasync);
  return fails("fsync", path_of(file)) ? -1 : real(file);
}

int rename(const char* from, const char* to) {
  static const auto real = NEXT(rename);
  return fails("rename", absolute(to)) ? -1 : real(from, to);
}

int open(const char* path, int flags, ...) {
  static const auto real = NEXT(open);
  MODE(flags);
  return writes(flags) && fails("open", absolute(path)) ? -1 : real(path, flags, mode);
}

int openat(int folder, const char* path, int flags, ...) {
  static const auto real = NEXT(openat);
  MODE(flags);
  return writes(flags) && fails("open", absolute(path, folder)) ? -1 : real(folder, path, flags, mode);
}

int creat(const char* path, mode_t mode) {
  static const auto real = NEXT(creat);
  return fails("open", absolute(path)) ? -1 : real(path, mode);
}

FILE* fopen(const char* path, const char* mode) {
  static const auto real = NEXT(fopen);
  return writes(mode) && fails("open", absolute(path)) ? nullptr : real(path, mode);
}

ssize_t read(int file, void* bytes, size_t size) {
  static const auto real = NEXT(read);
  if (fails("read", path_of(file))) return -1;
  return real(file, bytes, size > 1 && fails("short", path_of(file)) ? size / 2 : size);
}

ssize_t pread(int file, void* bytes, size_t size, off_t at) {
  static const auto real = NEXT(pread);
  if (fails("read", path_of(file))) return -1;
  return real(file, bytes, size > 1 && fails("short", path_of(file)) ? size / 2 : size, at);
}

size_t fread(void* bytes, size_t size, size_t count, FILE* stream) {
  static const auto real = NEXT(fread);
  return fails("read", path_of(fileno(stream))) ? 0 : real(bytes, size, count, stream);
}

// The names of the same functions in programs with 64-bit file offsets, such as Python.
#define SAME(name) __attribute__((alias(#name)))
int open64(const char* path, int flags, ...) SAME(open);
int openat64(int folder, const char* path, int flags, ...) SAME(openat);
int creat64(const char* path, mode_t mode) SAME(creat);
FILE* fopen64(const char* path, const char* mode) SAME(fopen);
ssize_t pwrite64(int file, const void* bytes, size_t size, off64_t at) SAME(pwrite);
ssize_t pread64(int file, void* bytes, size_t size, off64_t at) SAME(pread);
}
