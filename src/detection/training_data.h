// Training samples with fewer returns than were recorded, so that a detector has to look at its picture too.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "detection/compact_frame.h"
#include "detection/ground_truth_sampling.h"

namespace mirage {

/// In a `share` of the samples, half and half: only every 2nd, 4th or 8th beam of the unit stays, or 30 % of
/// the cars and of what looks like one lose 70 to 100 % of the returns that are more than 0.2 m over the
/// ground. Picture and truth stay as they are. Depends on (seed, index) and the frame alone.
void thin_lidar(CompactFrame& frame, const LidarModel& lidar, double share, std::uint64_t seed,
                std::uint64_t index);

// Training samples: frames kept small in memory, in an order and with changes that depend on the seed alone.

/// One augmented sample with the memory it points to.
struct PreparedSample {
  ImageF image;
  std::vector<LidarPoint> points;
  Calibration calibration;
  std::vector<BevBox> boxes, ignore;
  std::vector<PictureBox> picture_boxes, picture_ignore;
  std::vector<std::uint8_t> vehicle_mask;
  std::uint64_t picture_key = 0;
  Eigen::Affine3d data_from_sample = Eigen::Affine3d::Identity();
  /// Views of what this holds; valid as long as it is.
  TrainingSample view() const;
};

/// Their views; valid as long as the samples are.
std::vector<TrainingSample> views_of(const std::vector<PreparedSample>& samples);

/// As kept: the picture in 8-bit sRGB, points in view, truth by ground_truth(); no mask and no key.
CompactFrame compact(const Frame& frame, const std::array<double, 4>& region);

/// The frame of a data set, with its key, and its mask if training/instance_2/ID.png is there (instance k + 1
/// is label k). InputError as read_frame's, and if those are not of the image's size.
CompactFrame read_compact(const std::filesystem::path& data, const std::string& id,
                          const std::array<double, 4>& region);

/// The frame after sample_from_data; boxes that leave the region are ignored.
PreparedSample prepared_sample(const CompactFrame& frame, const Eigen::Affine3d& sample_from_data,
                               const std::array<double, 4>& region);

/// Flip of y (half of the samples), a turn of up to ±10° about z, a scale of 0.95–1.05 and a lift of up to
/// ±0.15 m: sample_from_data. Depends on (seed, index) alone.
Eigen::Affine3d random_pose(std::uint64_t seed, std::uint64_t index);
/// A box of the data after sample_from_data (a similarity that keeps z upright).
BevBox moved(const BevBox& box, const Eigen::Affine3d& sample_from_data);

/// The training set as a detector sees it: compact, augmented, in an order that depends on the seed alone.
class TrainingData {
 public:
  /// `pasted`: mean number of vehicles of other frames pasted into a sample (see GroundTruthSampler).
  /// `thinned`: share of the samples that lose returns (thin_lidar). `rig`: which recorded the set, as
  /// data_rig.h takes it.
  TrainingData(const std::filesystem::path& data, std::size_t limit, const std::array<double, 4>& region,
               std::uint64_t seed, double pasted = 0, bool with_picture = true, double thinned = 0,
               const std::string& rig = "");
  /// Number of frames, before augmentation.
  std::size_t size() const { return ids_.size(); }
  /// The frame of the `index`-th sample: every epoch is a new permutation of all frames.
  std::size_t frame_of(std::uint64_t index) const;
  /// The samples of step `step` (batch · step …). Reads what is not in memory yet; safe on a worker thread.
  std::vector<PreparedSample> prepare(std::int64_t step, int batch);

 private:
  const CompactFrame& frame(std::size_t number);

  std::filesystem::path data_;
  std::vector<std::string> ids_;
  std::array<double, 4> region_;
  std::uint64_t seed_;
  std::vector<CompactFrame> frames_;  // empty srgb: not read yet
  std::size_t bytes_ = 0;
  CompactFrame passing_;  // used once memory for frames is spent
  std::unique_ptr<GroundTruthSampler> sampler_;
  double thinned_ = 0;
  LidarModel lidar_;
};

}  // namespace mirage
