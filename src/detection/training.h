// Training a detector on a data set: the host's side (order, augmentation, schedule, checkpoints).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "detection/detect.h"

namespace mirage {

/// What `mirage train` is asked for.
struct TrainingOptions {
  std::filesystem::path data, validation, out;  ///< `validation` may be empty
  /// Weights to start from; empty: fresh ones. `fusion` may start from a `lidar` detector's.
  std::filesystem::path start = {};
  /// Weights of a camera and of a lidar detector that the branches of the new one start from; may be empty.
  std::filesystem::path camera = {}, lidar = {};
  std::string detector = "fusion";
  /// The whole network learns: branches that were taken over (`camera`, `lidar`), and the trunk of a camera
  /// network that was started from COCO's weights; boxes in the picture are a task beside.
  bool joint = false;
  /// Of a camera network that was started from COCO's weights, the layers that find boxes learn, and nothing
  /// else: for frames that do not say which pixels show vehicles. Not with `joint`.
  bool heads = false;
  std::int64_t steps = 4000;
  int batch = 2;
  double learning_rate = 2e-3;  ///< peak of the one-cycle schedule
  double minutes = 0;  ///< 0: no limit. Otherwise the schedule ends at steps or minutes, which is first
  std::int64_t checkpoint_every = 250;
  double checkpoint_seconds = 0;      ///< > 0: also where so many seconds have passed since the last one
  double ground_truth_sampling = 0;   ///< mean number of vehicles pasted into a sample (GroundTruthSampler)
  double thin_lidar = 0.5;            ///< share of the samples that lose LiDAR returns (thin_lidar)
  std::size_t frames = 0;             ///< only the first N frames (0: all)
  std::size_t validation_frames = 0;  ///< only the first N (0: all)
  std::int64_t validate_every = 0;    ///< steps between validations (0: at the end only)
  std::string precision = "float";    ///< of convolutions: float or bfloat16
  std::uint64_t seed = 0;
  int threads = 0;
  bool quiet = false;
};

/// What a training ends with, beside the weights in TrainingOptions::out.
struct TrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  TrainingLoss loss;              ///< running mean at the end
  std::filesystem::path weights;  ///< out/DETECTOR.weights
  bool validated = false;
  PrecisionRecall at50, at70;  ///< on `validation`
};

/// Trains from scratch or from `start`, or goes on from the newest checkpoint in `out` (which must be of the
/// same options, or InputError). What step s sees depends on (seed, s) alone: not on threads, nor on
/// interruptions. A checkpoint is written every checkpoint_every steps, before each validation and on Ctrl-C
/// (then Interrupted is thrown). out/training.jsonl has a line every 50 steps {step, seconds, rate, loss,
/// score_loss, box_loss: running means} and one for each validation {step, seconds, ap50, ap70, recall50}.
TrainingResult train_detector(const TrainingOptions& options);

}  // namespace mirage
