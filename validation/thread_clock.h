// CPU time of the calling thread: on a busy machine it varies less than the wall clock's.
#pragma once

#include <ctime>

namespace mirage {

/// CPU time that work() takes on the calling thread, ms.
template <class Work>
double cpu_ms(const Work& work) {
  const auto now = [] {
    timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
  };
  const double start = now();
  work();
  return now() - start;
}

}  // namespace mirage
