// How many threads LibTorch takes, and the BLAS under it. Include after the LibTorch headers.
#pragma once

#include <atomic>

extern "C" {
/// OpenBLAS's own, where that is the BLAS at hand; else null.
void openblas_set_num_threads(int) __attribute__((weak));
}

namespace mirage {

/// From here on: LibTorch in the calling thread, OpenBLAS in the whole process. With one they work in the
/// thread that asks them. More spin while they wait, which costs a multiple of the work on a busy machine,
/// and make sums depend on their number.
inline void set_torch_threads(int count) {
  static std::atomic<int> blas = 0;
  at::set_num_threads(count);
  if (openblas_set_num_threads && blas.exchange(count) != count) openblas_set_num_threads(count);
}

}  // namespace mirage
