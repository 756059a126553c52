#include "base/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>

#include <memory>

namespace mirage {
namespace {
std::unique_ptr<tbb::global_control> control;
int count = 0;
}  // namespace

void set_thread_count(int threads) {
  count = threads;
  control.reset();
  if (threads > 0)
    control = std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism,
                                                    static_cast<std::size_t>(threads));
}

int thread_count() {
  return count > 0 ? count : tbb::info::default_concurrency();
}

}  // namespace mirage
