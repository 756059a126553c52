// KITTI labels of what stands in a generated street.
#pragma once

#include <span>

#include "generator/street.h"
#include "scene/frame.h"

namespace mirage::generator {

/// Labels of the placed things that a return came from or that show 25 rows of pixels in `object` (ids at
/// pixel centres), if any part of them is within the picture's frame. 2-D box: the projected surfaces,
/// clipped to the image, without what is on the roof; truncation: the share of that box cut off; occlusion:
/// from the share of the thing's own pixels that are visible (> 0.8: 0, > 0.35: 1, else 2; no pixel at all:
/// 3, as KITTI's "unknown": detection then asks for nothing).
struct StreetLabels {
  std::vector<Label> labels;
  std::vector<int> line;  ///< of each placed thing: its index in `labels`, −1 where it has none
};
/// `returned`: the thing that each return of the sweep came from, −1 for none of them (simulate_sweep).
StreetLabels label_street(const Street& street, const Calibration& calibration, const Image<int>& object,
                          std::span<const int> returned);

}  // namespace mirage::generator
