// The schedule of a training: how long it goes on, at which rate, and when its state is written.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <numbers>

#include "base/checkpoint_timer.h"
#include "base/fields.h"
#include "base/interrupt.h"

namespace mirage {

/// What every training is asked for, whatever learns (base/training_loop.h).
struct TrainingSchedule {
  std::filesystem::path out;  ///< holds the run's state and its result
  std::int64_t steps = 4000;
  int batch = 2;
  double learning_rate = 2e-3;  ///< peak of one_cycle()
  double minutes = 0;           ///< > 0: the schedule ends at `steps` or then, which is first
  CheckpointInterval checkpoint{250};
  std::size_t frames = 0;  ///< only the first N (0: all)
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: as set by set_thread_count
  bool quiet = false;
  /// Asked after every step; true ends the run with a checkpoint, and throws Interrupted.
  std::function<bool()> stop = interrupted;
};

/// `frames` is of no identity: which frames there were is the trainer's to say.
template <class Visitor, FieldsOf<TrainingSchedule> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "steps", .help = "updates of the model", .range = kFromOne}, s.steps);
  visit({.name = "batch", .help = "samples an update", .range = kFromOne}, s.batch);
  visit({.name = "learning_rate", .help = "peak of the one-cycle schedule", .range = kPositive},
        s.learning_rate);
  visit({.name = "minutes",
         .help = "end the schedule after this time (0: no limit)",
         .range = kNotNegative,
         .lacking = "0"},
        s.minutes);
  visit_fields(visit, s.checkpoint);
  visit({.name = "frames", .help = "only the first N frames (0: all)", .decides = false}, s.frames);
  visit({.name = "seed", .option = ""}, s.seed);  // every command has one
}

/// Learning rate at `progress` in [0, 1]: a linear rise over the first 5 %, then half a cosine down to 1 % of
/// the peak.
inline double one_cycle(double peak, double progress) {
  constexpr double rise = 0.05, floor = 0.01;
  progress = std::clamp(progress, 0.0, 1.0);
  if (progress < rise) return peak * (0.05 + 0.95 * progress / rise);
  const double along = (progress - rise) / (1 - rise);
  return peak * (floor + (1 - floor) * 0.5 * (1 + std::cos(std::numbers::pi * along)));
}

}  // namespace mirage
