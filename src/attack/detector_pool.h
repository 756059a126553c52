// Several instances of one detector: each serves one thread at a time, and all return the same.
#pragma once

#include <memory>
#include <vector>

#include "base/parallel.h"
#include "detection/detector.h"

namespace mirage {

/// Instances of one detector on the same weights, one for each thread.
using DetectorPool = std::vector<std::unique_ptr<Detector>>;

/// One instance a thread, but no more than `most`; they share weights if the plugin can.
DetectorPool load_detector_pool(const DetectorOptions& options, int most);

/// Pointers to the instances, in the pool's order.
std::vector<Detector*> instances(const DetectorPool& pool);

/// Adds instances that share the weights of the pool's first, up to one a thread and at most `most`; none if
/// the plugin cannot share weights.
void add_shared(DetectorPool& pool, int most);

/// Calls body(detector, i) for i in [0, n) on as many threads as there are instances. Bodies must write to
/// disjoint memory.
template <class Body>
void for_each_with_detector(const DetectorPool& pool, std::size_t n, const Body& body) {
  hand_out(pool.size(), n, [&](std::size_t worker, std::size_t i) { body(*pool[worker], i); });
}

}  // namespace mirage
