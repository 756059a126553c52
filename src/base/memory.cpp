#include "base/memory.h"

#include <fcntl.h>
#include <malloc.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "base/error.h"

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

}  // namespace mirage

extern "C" {
/// oneTBB's (tbb/scalable_allocator.h), where its allocator is part of the program; else null.
int scalable_allocation_command(int command, void* parameter) __attribute__((weak));
}

namespace mirage {

void return_unused_memory() {
  constexpr int kCleanAllBuffers = 0;  // TBBMALLOC_CLEAN_ALL_BUFFERS
  if (scalable_allocation_command) scalable_allocation_command(kCleanAllBuffers, nullptr);
  malloc_trim(0);
}

}  // namespace mirage
