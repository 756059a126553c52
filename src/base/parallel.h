// Parallel loops on oneTBB. Bodies write to disjoint places; sums are taken afterwards in index order,
// so that results do not depend on the number of threads.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cstddef>

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace mirage {

/// What ThreadSanitizer cannot see of a oneTBB that was built without it: every part of a loop comes after
/// the loop's start and before its end. Parts among themselves have no order. Nothing in other builds.
namespace loop_order {
#ifdef __SANITIZE_THREAD__
inline char started, finished;
inline void loop_starts() {
  __tsan_release(&started);
}
inline void part_starts() {
  __tsan_acquire(&started);
}
inline void part_ends() {
  __tsan_release(&finished);
}
inline void loop_ends() {
  __tsan_acquire(&finished);
}
#else
inline void loop_starts() {}
inline void part_starts() {}
inline void part_ends() {}
inline void loop_ends() {}
#endif
}  // namespace loop_order

/// Bounds the threads of every later loop (0: as many as the machine has).
void set_thread_count(int threads);
/// The bound in force.
int thread_count();

/// Calls body(i) for i in [0, n), in any order, on several threads.
template <class Body>
void parallel_for(std::size_t n, const Body& body, std::size_t grain = 1) {
  loop_order::loop_starts();
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, n, grain),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      loop_order::part_starts();
                      for (std::size_t i = range.begin(); i != range.end(); ++i) body(i);
                      loop_order::part_ends();
                    });
  loop_order::loop_ends();
}

/// Runs work() so that parallel loops inside it never pick up tasks from outside: needed wherever a lock is
/// held.
template <class Work>
void isolated(const Work& work) {
  tbb::this_task_arena::isolate(work);
}

}  // namespace mirage
