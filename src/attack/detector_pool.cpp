#include "attack/detector_pool.h"

#include <algorithm>

namespace mirage {

DetectorPool load_detector_pool(const DetectorOptions& options, int most) {
  DetectorPool pool;
  DetectorOptions each = options;
  each.threads = 1;
  for (int i = 0; i < std::max(1, std::min(most, thread_count())); ++i) pool.push_back(load_detector(each));
  return pool;
}

}  // namespace mirage
