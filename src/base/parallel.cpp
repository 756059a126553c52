#include "base/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>

#include "base/sizes.h"

namespace mirage {
namespace {
std::unique_ptr<tbb::global_control> control;
int threads_in_use = 0;
}  // namespace

void set_thread_count(int threads) {
  threads_in_use = threads;
  control.reset();
  if (threads > 0)
    control =
        std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism, as_size(threads));
}

int thread_count() {
  return threads_in_use > 0 ? threads_in_use : tbb::info::default_concurrency();
}

}  // namespace mirage
