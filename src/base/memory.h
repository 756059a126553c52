// Memory that another process of this machine reads and writes.
#pragma once

#include <cstddef>
#include <cstring>
#include <string>

namespace mirage {

/// Shared memory without a name in any file system, so that nothing is left behind however a process ends.
/// Pages that are never written take no memory.
class SharedMemory {
 public:
  /// Failure if the system gives none.
  SharedMemory();
  ~SharedMemory();
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;

  /// Grows to at least `bytes`. The content stays; data() may change. No other process can shrink it. Failure
  /// if there is no room.
  void reserve(std::size_t bytes);
  /// The first byte; null before reserve().
  char* data() const { return data_; }
  /// Size of data() in bytes.
  std::size_t size() const { return size_; }
  /// Where another process of the same user opens it, as long as this one lives: "/proc/4711/fd/9".
  std::string path() const;

 private:
  int file_ = -1;
  char* data_ = nullptr;
  std::size_t size_ = 0;
};

// Memory of one process.

/// memcpy for lists that may be empty: their pointer may be null, which memcpy does not allow.
inline void copy_bytes(void* to, const void* from, std::size_t bytes) {
  if (bytes > 0) std::memcpy(to, from, bytes);
}

/// Memory of the machine, or of the process's control group if that has less (a container, a Slurm job), in
/// bytes.
std::size_t machine_memory();

/// Returns freed memory that the allocators keep to the system: tcmalloc's, if the program has it, and
/// glibc's. An attack frees gigabytes that it would otherwise hold through the evaluation after it.
void return_unused_memory();

}  // namespace mirage
