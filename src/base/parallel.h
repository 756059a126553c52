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

/// What ThreadSanitizer cannot see of a oneTBB that was built without it: every part of a loop comes after
/// the loop's start and before its end, also if one throws. Parts among themselves have no order. Nothing in
/// other builds.
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

/// A loop within a loop that fails: it was stopped half way, so nothing may be made of it.
class LoopStopped : public std::runtime_error {
 public:
  LoopStopped() : std::runtime_error("stopped: another part of the work failed") {}
};

/// LoopStopped if this runs in a part of a loop whose other part has failed.
inline void throw_if_loop_stopped() {
  if (tbb::is_current_task_group_canceling()) throw LoopStopped();
}

/// Calls body(i) for i in [0, n), in any order, on several threads. The first exception of a body ends the
/// loop and comes out of it. Loops within its other bodies then throw LoopStopped: oneTBB ends them early,
/// and would return as if all of their parts were done.
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

/// Calls body(worker, i) for i in [0, n), work of uneven size: each of so many workers, which have something
/// of their own (a detector, a process), takes the next i on a thread of its own when it is done with its
/// last. After the first exception of a body nothing more is taken.
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

/// A value that costs something and that nobody may ask for: made when it is first asked for, once for all
/// copies. Several threads may ask; if making it throws, that is for who asked, and the next makes it again.
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
