#include "base/unused_memory.h"

#include <malloc.h>

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
