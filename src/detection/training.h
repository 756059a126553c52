// Training a detector on a data set: the host's side (order, augmentation, schedule, checkpoints).
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "base/schedule.h"
#include "detection/detect.h"
#include "detection/ground_truth_sampling.h"
#include "scene/data/data_rig.h"

namespace mirage {

// Training samples with fewer returns than were recorded, so that a detector has to look at its picture too.

/// In a `share` of the samples, with equal probability: only every 2nd, 4th or 8th beam of the unit stays, or
/// 30 % of the cars and look-alikes lose 70 to 100 % of their returns more than 0.2 m over the ground.
/// Picture and truth do not change. Depends on (seed, index) and the frame alone.
void thin_lidar(CompactFrame& frame, const LidarModel& lidar, double share, std::uint64_t seed,
                std::uint64_t index);

// Training samples: frames kept small in memory, in an order and with changes that depend on the seed alone.

/// One augmented sample with the memory it points to.
struct PreparedSample {
  ImageF image;
  std::vector<LidarPoint> points;
  Calibration calibration;
  std::vector<std::uint8_t> vehicle_mask;
  TrainingSample truth;  ///< without its views of these
  /// Views of this sample's memory; valid while it lives.
  TrainingSample view() const;
};

/// Views of the samples; valid while these live.
std::vector<TrainingSample> views_of(const std::vector<PreparedSample>& samples);

/// The frame's picture in 8-bit sRGB, points in view and truth by ground_truth(); no mask and no key.
CompactFrame compact(const Frame& frame, const std::array<double, 4>& region);

/// The frame of a data set, with its key, and its mask if training/instance_2/ID.png is there (instance k + 1
/// is label k). InputError as read_frame's, and if the mask is not of the image's size.
CompactFrame read_compact(const std::filesystem::path& data, const std::string& id,
                          const std::array<double, 4>& region);

/// The frame after augmented_from_recorded; boxes that leave the region are ignored.
PreparedSample prepared_sample(const CompactFrame& frame, const Eigen::Affine3d& augmented_from_recorded,
                               const std::array<double, 4>& region);

/// Flip of y (half of the samples), a turn of up to ±10° about z, a scale of 0.95–1.05 and a lift of up to
/// ±0.15 m: augmented_from_recorded. Depends on (seed, index) alone.
Eigen::Affine3d random_pose(std::uint64_t seed, std::uint64_t index);
/// A box of the data after augmented_from_recorded (a similarity that keeps z upright).
BevBox moved(const BevBox& box, const Eigen::Affine3d& augmented_from_recorded);

/// The training set as a detector sees it: compact, augmented, in an order that depends on the seed alone.
class TrainingData {
 public:
  /// `pasted`: mean number of vehicles of other frames pasted into a sample (see GroundTruthSampler).
  /// `thinned`: share of the samples that lose returns (thin_lidar). `rig`: the recording rig, as in
  /// data_rig.h.
  TrainingData(const std::filesystem::path& data, std::size_t limit, const std::array<double, 4>& region,
               std::uint64_t seed, double pasted = 0, bool with_picture = true, double thinned = 0,
               const std::string& rig = "");
  /// Number of frames, before augmentation.
  std::size_t size() const { return ids_.size(); }
  /// The frame of the `index`-th sample: every epoch is a new permutation of all frames.
  std::size_t frame_of(std::uint64_t index) const;
  /// The samples of step `step` (batch · step …). Reads frames not in memory yet; safe on a worker thread.
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

/// The options of `mirage train`.
struct TrainingOptions : TrainingSchedule {
  std::filesystem::path data, validation;  ///< `validation` may be empty
  /// Weights to start from; empty: fresh ones. `fusion` may start from a `lidar` detector's.
  std::filesystem::path start = {};
  /// Weights of a camera and of a lidar detector that the branches of the new one start from; may be empty.
  std::filesystem::path camera = {}, lidar = {};
  std::string detector = "fusion";
  /// The whole network learns: branches that were taken over (`camera`, `lidar`), and the trunk of a camera
  /// network started from COCO's weights. Boxes in the picture are then an additional task.
  bool joint = false;
  /// Only the layers that find boxes learn, in a camera network started from COCO's weights: for frames
  /// without vehicle masks. Not with `joint`.
  bool heads = false;
  /// Share of the start's weights in the result; the rest are the learned ones. It keeps the start's
  /// knowledge of other data (Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022).
  double keep_start = 0;
  double ground_truth_sampling = 0;   ///< mean number of vehicles pasted into a sample (GroundTruthSampler)
  double thin_lidar = 0.5;            ///< share of the samples that lose LiDAR returns (thin_lidar)
  std::size_t validation_frames = 0;  ///< only the first N (0: all)
  std::int64_t validate_every = 0;    ///< steps between validations (0: at the end only)
  std::string precision = "float";    ///< of convolutions: float or bfloat16
  std::string rig = {};               ///< of both sets (scene/data/data_rig.h); empty: the sets' own
};

/// Files enter the run's identity by their content (train_detector), not by their path.
template <class Visitor, FieldsOf<TrainingOptions> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "data",
         .help = "training set (KITTI's object, tracking or raw layout, nuScenes)",
         .required = true},
        s.data);
  visit({.name = "rig", .help = kRigHelp, .lacking = ""}, s.rig);
  visit({.name = "detector", .help = "lidar, camera, painted, fusion, late or refined"}, s.detector);
  visit({.name = "start",
         .help = "weights to start from; fusion may start from lidar weights, refined from fusion ones",
         .otherwise = "fresh ones",
         .decides = false},
        s.start);
  visit({.name = "camera",
         .help = "detector: weights of a camera detector that the new one starts from",
         .decides = false},
        s.camera);
  visit({.name = "lidar",
         .help = "detector: weights of a lidar detector that the new one starts from",
         .decides = false},
        s.lidar);
  visit({.name = "joint",
         .help = "detector: also train the parts loaded from --camera, --lidar and COCO's weights",
         .otherwise = "frozen",
         .lacking = "false"},
        s.joint);
  visit({.name = "heads",
         .help = "detector camera: train the box heads instead of the mask (the mask needs frames "
                 "with instances)",
         .lacking = "false"},
        s.heads);
  visit({.name = "keep_start",
         .help = "detector: share of --start's weights mixed into the result",
         .range = kShare,
         .lacking = "0"},
        s.keep_start);
  visit({.name = "precision",
         .help = "detector: precision of convolutions: float or bfloat16 (float where the "
                 "processor lacks it)",
         .decides = false},
        s.precision);
  visit_fields(visit, as_base<TrainingSchedule>(s));
  visit({.name = "validation", .help = "data set to score the result on", .decides = false}, s.validation);
  visit({.name = "validation_frames", .help = "only the first N (0: all)", .decides = false},
        s.validation_frames);
  visit({.name = "validate_every",
         .help = "detector: steps between validations (0: at the end only)",
         .range = kNotNegative,
         .decides = false},
        s.validate_every);
  visit({.name = "ground_truth_sampling",
         .help = "detector: mean number of other frames' vehicles pasted into a sample; fusion needs a set "
                 "made with --truth",
         .range = {0, 20},
         .lacking = "0"},
        s.ground_truth_sampling);
  visit({.name = "thin_lidar",
         .help = "detector: share of the samples that lose beams, or returns of some cars",
         .range = kShare,
         .lacking = "0"},
        s.thin_lidar);
}

/// The result of a training, beside the weights in TrainingOptions::out.
struct TrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  TrainingLoss loss;              ///< running mean at the end
  std::filesystem::path weights;  ///< out/DETECTOR.weights
  bool validated = false;
  PrecisionRecall at50, at70;  ///< on `validation`
};

/// Trains from scratch or from `start`, or resumes from the newest checkpoint in `out`. InputError if its
/// options, frames or rig differ; FieldError for options out of range, or that the detector does not have.
/// The data of step s depend on (seed, s) alone: not on threads, nor on interruptions. A checkpoint is
/// written every checkpoint.steps steps, before each validation and on Ctrl-C (then Interrupted is thrown).
/// out/training.jsonl has a line every 50 steps {step, seconds, rate, loss, score_loss, box_loss: running
/// means} and one for each validation {step, seconds, ap50, ap70, recall50}.
TrainingResult train_detector(const TrainingOptions& options);

}  // namespace mirage
