// Dense depth from a sparse sweep.
#pragma once

#include "scene/frame.h"

namespace mirage {

/// Depth of pixels with no information (sky, unfilled): everything is in front of it.
inline constexpr float kFarDepth = 1e6f;

/// Projects the sweep into the image: planar depth (camera z, m) of the nearest return a pixel, 0 where none.
ImageF sparse_depth(const Sweep& sweep, const Calibration& calibration);

/// IP-Basic (Ku, Harakeh, Waslander, CRV 2018), "fast" variant without extrapolation to the image's top:
/// inverted depth, diamond dilation, small and large hole closing, median and Gaussian blur.
/// Unfilled pixels are kFarDepth.
ImageF complete_depth(const ImageF& sparse);

}  // namespace mirage
