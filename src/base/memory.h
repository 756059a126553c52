// Memory that another process of this machine reads and writes.
#pragma once

#include <cstddef>
#include <cstring>
#include <string>

namespace mirage {

/// Without a name in any file system, so that nothing is left behind however a process ends. Pages that
/// nobody writes to take no room.
class SharedMemory {
 public:
  /// Failure if the system gives none.
  SharedMemory();
  ~SharedMemory();
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;

  /// At least so many bytes; what was written stays, data() may change. No other process can make it smaller
  /// under us. Failure if there is no room.
  void reserve(std::size_t bytes);
  /// The first byte; null before reserve().
  char* data() const { return data_; }
  /// Bytes that data() has.
  std::size_t size() const { return size_; }
  /// Where another process of the same user opens it, as long as this one lives: "/proc/4711/fd/9".
  std::string path() const;

 private:
  int file_ = -1;
  char* data_ = nullptr;
  std::size_t size_ = 0;
};

// Memory of one process.

/// memcpy for lists that may be empty: these may lie nowhere (null), which memcpy must not be given.
inline void copy_bytes(void* to, const void* from, std::size_t bytes) {
  if (bytes > 0) std::memcpy(to, from, bytes);
}

/// What the machine has, or the process's control group where that has less (a container, a job of Slurm);
/// bytes.
std::size_t machine_memory();

/// Gives back to the system what the allocator keeps of freed memory: tcmalloc's, where the program has it,
/// and glibc's. An attack frees gigabytes that it would otherwise hold through the evaluation after it.
void return_unused_memory();

}  // namespace mirage
