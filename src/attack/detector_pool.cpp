#include "attack/detector_pool.h"

#include <algorithm>

#include "base/sizes.h"
#include "detection/process_detector.h"

namespace mirage {

namespace {

std::size_t pool_size(int most) {
  return as_size(std::min(most, thread_count()));
}

}  // namespace

std::vector<Detector*> instances(const DetectorPool& pool) {
  std::vector<Detector*> all(pool.size());
  std::ranges::transform(pool, all.begin(), [](const auto& detector) { return detector.get(); });
  return all;
}

void add_shared(DetectorPool& pool, int most) {
  while (pool.size() < pool_size(most)) {
    auto other = pool.front()->share();
    if (!other) return;
    pool.push_back(std::move(other));
  }
}

DetectorPool load_detector_pool(const DetectorOptions& options, int most) {
  DetectorPool pool;
  if (is_in_process(options)) most = 1;
  DetectorOptions each = options;
  each.threads = 1;
  pool.push_back(load_detector(each));
  add_shared(pool, most);
  while (pool.size() < pool_size(most)) pool.push_back(load_detector(each));
  return pool;
}

}  // namespace mirage
