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

/// A frame as training keeps it: 8-bit sRGB picture, points in view, boxes.
struct CompactFrame {
  int width = 0, height = 0;
  std::vector<std::uint8_t> srgb;
  std::vector<LidarPoint> points;
  Calibration calibration;
  GroundTruth truth;
  /// Row-major: whether the pixel shows a vehicle. Empty if the data set has no masks.
  std::vector<bool> vehicle_mask = {};
  std::uint64_t picture_key = 0;  ///< TrainingSample::picture_key
};

/// A labelled car, cut out of the frame it was seen in.
struct CutOut {
  Box3 box;
  PictureBox picture;  ///< the label's
  Difficulty difficulty = Difficulty::easy;
  std::vector<LidarPoint> points;  ///< `velo`
  PinholeCamera camera;
  Transform camera_from_velo = Transform::Identity();
  PixelRect rect;            ///< of the picture; empty without pixels
  Image<std::uint8_t> srgb;  ///< rect's pixels
  Image<std::uint8_t> mask;  ///< 1 where the pixel is the car's
};

/// A car with fewer returns is not cut out, and not pasted if nearer returns leave it fewer.
inline constexpr std::size_t kMinPoints = 5;

/// The fully visible cars of a frame that detection counts (see ground_truth), with kMinPoints or more.
/// Points: those that training/instance_velodyne/ID.label gives to the label (SemanticKITTI's layout: upper
/// 16 bits k + 1), or else those in its box grown by 0.1 m, without the lowest 0.1 m. Pixels: those that
/// training/instance_2/ID.png (16-bit, k + 1) gives to it; none if !with_picture.
std::vector<CutOut> cut_out_cars(const std::filesystem::path& data, const std::string& id,
                                 const std::array<double, 4>& region, bool with_picture);

// Ground-truth sampling: vehicles of the training set pasted into other frames of it (Yan et al., SECOND,
// Sensors 2018), with their pixels if the set has instance masks (as in Wang et al., PointAugmenting, CVPR
// 2021).

/// The properties of the LiDAR unit that decide which returns hide which.
struct SamplingUnit {
  Vec3d origin = Vec3d::Zero();  ///< m, `velo`: mean origin of the beams
  double azimuth_step = 0;       ///< rad
  double beam_gap = 0;           ///< rad, median between neighbouring beams
};
/// Computed from the unit's beams.
SamplingUnit sampling_unit(const LidarModel& lidar);

/// Pastes the car at its own pose: range, direction and pixels stay true. It is lifted (points, and pixels by
/// whole rows) to the ground there if that differs by 0.05–0.2 m. False, and the frame is untouched, when
/// - the ground differs by more, or the camera is another one;
/// - its box comes within 0.3 m of a present box, or more than 2 points stand in it;
/// - nearer returns hide more than 30 % of its points, or leave fewer than 5;
/// - it would leave a present box fewer than half of its points, or fewer than 3.
/// Hidden points and pixels are not pasted. Returns behind the car, in directions that its own returns span
/// in their azimuth column, are removed. The car casts no shadow on its new ground. With pixels, the frame's
/// mask and picture boxes get the car, too; boxes of which it hides more than half are ignored from then on,
/// and the picture's key becomes 0.
bool paste(CompactFrame& frame, const CutOut& car, const SamplingUnit& unit);

/// The vehicles of a training set, ready to be pasted into its frames.
class GroundTruthSampler {
 public:
  /// `mean`: mean number of vehicles to paste into a sample (Poisson-distributed). With `with_picture`, a set
  /// without training/instance_2 gives nothing to paste, and a warning. `rig`: as data_rig.h takes it.
  GroundTruthSampler(const std::filesystem::path& data, const std::vector<std::string>& ids,
                     const std::array<double, 4>& region, std::uint64_t seed, double mean, bool with_picture,
                     const std::string& rig = "");
  /// Pastes vehicles into the frame, in up to 8 attempts for each; the choice depends on (seed, index) alone.
  /// Returns their number. Not for two threads at once.
  int augment(CompactFrame& frame, std::uint64_t index);
  /// Vehicles to choose from, before their points are counted.
  std::size_t size() const { return candidates_.size(); }

 private:
  struct Donor {
    bool read = false;
    std::vector<CutOut> cars;
  };
  const std::vector<CutOut>& cars_of(std::size_t frame);

  std::filesystem::path data_;
  std::vector<std::string> ids_;
  std::array<double, 4> region_;
  std::uint64_t seed_;
  double mean_;
  bool with_picture_;
  SamplingUnit unit_;
  std::vector<std::size_t> candidates_;  // frame of each labelled car that may be pasted
  std::vector<Donor> donors_;            // one a frame, read when first wanted
  std::size_t bytes_ = 0;
  Donor passing_;  // used once memory for donors is spent
};

}  // namespace mirage
