#include "frames/cached_detections.h"

namespace mirage {

std::vector<Detection> cached_detections(FrameStore& store, const std::string& frame,
                                         const std::string& detector, double score_threshold,
                                         const std::function<std::vector<Detection>(const Frame&)>& compute) {
  const auto now = [&] { return compute(store.get(frame)->frame); };
  if (detector.empty() || !store.cache().on()) return now();
  return store.cache().detections(store.content(frame), detector, score_threshold, now);
}

}  // namespace mirage
