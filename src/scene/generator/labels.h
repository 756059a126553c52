// KITTI labels of what stands in a generated street.
#pragma once

#include "scene/frame.h"
#include "scene/generator/street.h"

namespace mirage::generator {

/// Labels of the placed things that show at least one pixel in `object` (ids at pixel centres) and that hold
/// at least one point of the sweep. 2-D box: the projected surfaces, clipped to the image; truncation: the
/// share of that box cut off; occlusion: from the share of the thing's own pixels that are visible (> 0.8: 0,
/// > 0.35: 1, else 2).
struct StreetLabels {
  std::vector<Label> labels;
  std::vector<int> line;  ///< of each placed thing: its index in `labels`, −1 where it has none
};
StreetLabels label_street(const Street& street, const Calibration& calibration, const Image<int>& object,
                          const Sweep& sweep);

}  // namespace mirage::generator
