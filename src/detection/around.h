// What defences that stand around a detector share.
#pragma once

#include <algorithm>
#include <cmath>

#include "detection/detector.h"

namespace mirage {

/// What counts for a place of which a detector says nothing.
inline constexpr double kSilentLogit = -8;

/// The threshold that lets a detector say all that is above kSilentLogit, and no less than it is asked for.
inline double speaking_score(double asked) {
  return std::min(asked, Proposal{{}, kSilentLogit}.score());
}

/// Whether two boxes are of one vehicle: IoU above 0.1, as non-maximum suppression has it.
inline bool same_place(const BevBox& a, const BevBox& b) {
  constexpr double kOverlap = 0.1;
  const double reach = (std::hypot(a.length, a.width) + std::hypot(b.length, b.width)) / 2;
  return std::hypot(a.x - b.x, a.y - b.y) < reach && iou(a, b) > kOverlap;
}

}  // namespace mirage
