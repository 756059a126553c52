// Clean detections, kept on disk.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "frames/frame_store.h"

namespace mirage {

/// The detections of a frame as recorded: the kept ones, or else compute(frame)'s. `detector`:
/// detector_identity(); empty: not cached.
std::vector<Detection> cached_detections(FrameStore& store, const std::string& frame,
                                         const std::string& detector, double score_threshold,
                                         const std::function<std::vector<Detection>(const Frame&)>& compute);

}  // namespace mirage
