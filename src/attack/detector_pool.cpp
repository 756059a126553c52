#include "attack/detector_pool.h"

#include <algorithm>

namespace mirage {

DetectorPool load_detector_pool(const DetectorOptions& options, int most) {
  DetectorPool pool;
  DetectorOptions each = options;
  each.threads = 1;
  pool.push_back(load_detector(each));
  while (pool.size() < static_cast<std::size_t>(std::min(most, thread_count()))) {
    auto other = pool.front()->share();
    pool.push_back(other ? std::move(other) : load_detector(each));
  }
  return pool;
}

}  // namespace mirage
