// Memory between two tasks of one process.
#pragma once

namespace mirage {

/// Gives back to the system what the allocator keeps of freed memory: oneTBB's, where the program has it, and
/// glibc's. An attack frees gigabytes that it would otherwise hold through the evaluation after it.
void return_unused_memory();

}  // namespace mirage
