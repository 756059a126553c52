// A frame as training keeps it in memory.
#pragma once

#include <cstdint>
#include <vector>

#include "detection/average_precision.h"

namespace mirage {

/// A frame as training keeps it: 8-bit sRGB picture, points in view, boxes.
struct CompactFrame {
  int width = 0, height = 0;
  std::vector<std::uint8_t> srgb;
  std::vector<LidarPoint> points;
  Calibration calibration;
  GroundTruth truth;
  /// One a pixel, row-major: whether it shows a vehicle (is_vehicle). Empty where the data set does
  /// not tell.
  std::vector<bool> vehicle_mask = {};
  std::uint64_t picture_key = 0;  ///< TrainingSample::picture_key
};

}  // namespace mirage
