// Work of uneven size on several workers, each with something of its own: a detector, a process.
#pragma once

#include <atomic>
#include <cstddef>

#include "base/parallel.h"

namespace mirage {

/// Calls body(worker, i) for i in [0, n): each of so many workers, on a thread of its own, takes the next i
/// when it is done with its last. After the first exception of a body nothing more is taken.
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

}  // namespace mirage
