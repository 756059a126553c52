// Training a detector on a data set: the host's side (order, augmentation, schedule, checkpoints).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "detection/detect.h"

namespace mirage {

struct TrainingOptions {
  std::filesystem::path data, validation, out;  ///< `validation` may be empty
  std::string detector = "fusion";
  std::int64_t steps = 4000;
  int batch = 2;
  double learning_rate = 2e-3;  ///< peak of the one-cycle schedule
  double minutes = 0;  ///< 0: no limit. Otherwise the schedule ends at steps or minutes, which is first
  std::int64_t checkpoint_every = 250;
  std::size_t frames = 0;             ///< only the first N frames (0: all)
  std::size_t validation_frames = 0;  ///< only the first N (0: all)
  std::uint64_t seed = 0;
  int threads = 0;
  bool quiet = false;
};

struct TrainingResult {
  std::int64_t steps = 0;
  double seconds = 0, seconds_per_step = 0;
  TrainingLoss loss;              ///< running mean at the end
  std::filesystem::path weights;  ///< out/DETECTOR.weights
  bool validated = false;
  PrecisionRecall at50, at70;  ///< on `validation`
};

/// Trains from scratch, or goes on from the newest checkpoint in `out` (which must be of the same options, or
/// InputError). What step s sees depends on (seed, s) alone: not on threads, nor on interruptions. A
/// checkpoint is written every checkpoint_every steps and on Ctrl-C (then Interrupted is thrown).
TrainingResult train_detector(const TrainingOptions& options);

}  // namespace mirage
