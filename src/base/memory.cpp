#include "base/memory.h"

#include <fcntl.h>
#include <malloc.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "base/error.h"
#include "base/sizes.h"

extern "C" {
/// tcmalloc's (gperftools/malloc_extension_c.h), where it is part of the program; else null.
void MallocExtension_ReleaseFreeMemory(void) __attribute__((weak));
}

namespace mirage {
namespace {

[[noreturn]] void memory_failure(const char* what) {
  throw Failure("shared memory", std::string(what) + ": " + std::strerror(errno), "free some memory");
}

}  // namespace

SharedMemory::SharedMemory() : file_(::memfd_create("mirage", MFD_CLOEXEC | MFD_ALLOW_SEALING)) {
  if (file_ < 0) memory_failure("cannot be made");
  ::fcntl(file_, F_ADD_SEALS, F_SEAL_SHRINK);  // a page that is gone would kill us
}

SharedMemory::~SharedMemory() {
  if (data_) ::munmap(data_, size_);
  ::close(file_);
}

void SharedMemory::reserve(std::size_t bytes) {
  if (bytes <= size_) return;
  if (::ftruncate(file_, static_cast<off_t>(bytes)) != 0) memory_failure("cannot grow");
  void* data = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file_, 0);
  if (data == MAP_FAILED) memory_failure("cannot be mapped");
  if (data_) ::munmap(data_, size_);
  data_ = static_cast<char*>(data);
  size_ = bytes;
}

std::string SharedMemory::path() const {
  return "/proc/" + std::to_string(::getpid()) + "/fd/" + std::to_string(file_);
}

std::size_t machine_memory() {
  std::size_t bytes = as_size(::sysconf(_SC_PHYS_PAGES)) * as_size(::sysconf(_SC_PAGESIZE));
  // "0::/path" of the second version of control groups; each folder above it may have a limit as well.
  std::ifstream groups("/proc/self/cgroup");
  for (std::string line; std::getline(groups, line);) {
    if (!line.starts_with("0::/")) continue;
    for (std::filesystem::path group = line.substr(4);; group = group.parent_path()) {
      std::size_t most = 0;
      if (std::ifstream(std::filesystem::path("/sys/fs/cgroup") / group / "memory.max") >> most)  // or "max"
        bytes = std::min(bytes, most);
      if (group.empty()) break;
    }
  }
  return bytes;
}

void return_unused_memory() {
  if (MallocExtension_ReleaseFreeMemory) MallocExtension_ReleaseFreeMemory();
  malloc_trim(0);
}

}  // namespace mirage
