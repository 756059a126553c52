// Labelled cars, cut out of the frames they were seen in.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "detection/average_precision.h"

namespace mirage {

/// A labelled car, cut out of the frame it was seen in.
struct CutOut {
  Box3 box;
  PictureBox picture;  ///< the label's
  Difficulty difficulty = Difficulty::easy;
  std::vector<LidarPoint> points;  ///< `velo`
  PinholeCamera camera;
  Transform camera_from_velo = Transform::Identity();
  PixelRect rect;                  ///< of the picture; empty without pixels
  std::vector<std::uint8_t> srgb;  ///< rect's pixels × 3
  std::vector<std::uint8_t> mask;  ///< 1 where the pixel is the car's
};

/// A car with fewer returns than this is neither cut out nor left behind by what is put before it.
inline constexpr std::size_t kLeastPoints = 5;

/// The fully visible cars of a frame that detection counts (see ground_truth), with kLeastPoints or more.
/// Points: those that training/instance_velodyne/ID.label gives to the label (SemanticKITTI's layout: upper
/// 16 bits k + 1), or else those in its box grown by 0.1 m, without the lowest 0.1 m. Pixels: those that
/// training/instance_2/ID.png (16-bit, k + 1) gives to it; none if !with_picture.
std::vector<CutOut> cut_out_cars(const std::filesystem::path& data, const std::string& id,
                                 const std::array<double, 4>& region, bool with_picture);

/// Whether a label may name such a car: fully visible, and detection counts it.
bool may_be_cut_out(const Label& label, const std::array<double, 4>& region);

}  // namespace mirage
