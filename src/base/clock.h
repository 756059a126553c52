// Elapsed wall time.
#pragma once

#include <chrono>

namespace mirage {

/// The clock that work is timed with: it never goes back.
using Clock = std::chrono::steady_clock;

/// Seconds from `start` until now.
inline double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

}  // namespace mirage
