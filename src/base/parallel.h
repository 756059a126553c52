// Parallel loops on oneTBB. Bodies write to disjoint places; sums are taken afterwards in index order,
// so that results do not depend on the number of threads.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <tbb/task_group.h>

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <utility>

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace mirage {

/// Tells ThreadSanitizer the order that it cannot see in a oneTBB built without it: every part of a loop runs
/// after the loop's start and before its end, also if one throws. Parts have no order among themselves. Empty
/// in other builds.
#ifdef __SANITIZE_THREAD__
namespace loop_order {
inline char started, finished;
struct Loop {
  Loop() { __tsan_release(&started); }
  ~Loop() { __tsan_acquire(&finished); }
};
struct Part {
  Part() { __tsan_acquire(&started); }
  ~Part() { __tsan_release(&finished); }
};
}  // namespace loop_order
#else
namespace loop_order {
struct [[maybe_unused]] Loop {};
struct [[maybe_unused]] Part {};
}  // namespace loop_order
#endif

/// Bounds the threads of every later loop (0: as many as the machine has).
void set_thread_count(int threads);
/// The bound in force.
int thread_count();

/// Thrown by a nested loop that was stopped half way because the outer one failed: its results are partial.
class LoopStopped : public std::runtime_error {
 public:
  LoopStopped() : std::runtime_error("stopped: another part of the work failed") {}
};

/// LoopStopped if this runs in a part of a loop whose other part has failed.
inline void throw_if_loop_stopped() {
  if (tbb::is_current_task_group_canceling()) throw LoopStopped();
}

/// Calls body(i) for i in [0, n), in any order, on several threads. The first exception of a body ends the
/// loop and is rethrown. Loops within its other bodies then throw LoopStopped: oneTBB ends them early, and
/// would return as if all of their parts were done.
template <class Body>
void parallel_for(std::size_t n, const Body& body, std::size_t grain = 1) {
  {
    const loop_order::Loop loop;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, n, grain),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        const loop_order::Part part;
                        for (std::size_t i = range.begin(); i != range.end(); ++i) body(i);
                      });
  }
  throw_if_loop_stopped();
}

/// Calls body(worker, i) for i in [0, n), for work of uneven size. Each of `workers` workers, with its own
/// detector or process, takes the next i when its last one is done. After the first exception of a body no
/// further i is taken.
template <class Body>
void hand_out(std::size_t workers, std::size_t n, const Body& body) {
  std::atomic<std::size_t> next = 0;
  parallel_for(workers, [&](std::size_t worker) {
    try {
      for (std::size_t i = next++; i < n; i = next++) body(worker, i);
    } catch (...) {
      next = n;
      throw;
    }
  });
}

/// Runs work() so that parallel loops inside it never pick up tasks from outside: needed wherever a lock is
/// held.
template <class Work>
void isolated(const Work& work) {
  tbb::this_task_arena::isolate(work);
}

/// A costly value that may never be needed: computed at the first get(), once for all copies. Several threads
/// may call get(). If computing throws, the caller gets the exception and the next call tries again.
template <class T>
class Lazy {
 public:
  /// `make` computes the value, on the thread that asks first.
  explicit Lazy(std::function<T()> make) : state_(std::make_shared<State>()) {
    state_->make = std::move(make);
  }
  /// The value; it lives as long as any copy.
  const T& get() const {
    const std::lock_guard lock(state_->mutex);
    if (state_->make) {
      isolated([&] { state_->value = state_->make(); });
      state_->make = nullptr;
    }
    return state_->value;
  }

 private:
  struct State {
    std::mutex mutex;
    std::function<T()> make;  ///< null: it is made
    T value;
  };
  std::shared_ptr<State> state_;
};

}  // namespace mirage
