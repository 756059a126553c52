// Several instances of one detector: an instance serves one thread at a time, and all give the same answers.
#pragma once

#include <memory>
#include <vector>

#include "base/parallel.h"
#include "detection/detector.h"

namespace mirage {

/// Instances of one detector on the same weights, one for each thread.
using DetectorPool = std::vector<std::unique_ptr<Detector>>;

/// One instance a thread, but no more than `most`; they share their weights where the plugin lets them.
DetectorPool load_detector_pool(const DetectorOptions& options, int most);

/// Adds instances on the weights of the pool's first, one a thread but no more than `most`; none where the
/// plugin cannot share.
void add_shared(DetectorPool& pool, int most);

/// Calls body(detector, i) for i in [0, n) on as many threads as there are instances. Bodies write to
/// disjoint places.
template <class Body>
void for_each_with_detector(const DetectorPool& pool, std::size_t n, const Body& body) {
  hand_out(pool.size(), n, [&](std::size_t worker, std::size_t i) { body(*pool[worker], i); });
}

}  // namespace mirage
