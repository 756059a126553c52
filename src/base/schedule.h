// Elapsed wall time.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <numbers>

#include "base/error.h"
#include "base/fields.h"

namespace mirage {

/// The clock that work is timed with: it never goes back.
using Clock = std::chrono::steady_clock;

/// Seconds from `start` until now.
inline double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// When a long run writes its state: by steps, and by time.

/// How often a run writes a checkpoint: the most work that a kill loses.
struct CheckpointInterval {
  std::int64_t steps = 1;  ///< ≥ 1
  double seconds = 0;      ///< > 0: also this many seconds after the last checkpoint
};

/// Not part of the identity: how often the state is written does not change the result.
template <class Visitor, FieldsOf<CheckpointInterval> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "checkpoint_every",
         .help = "steps between checkpoints",
         .range = kFromOne,
         .decides = false,
         .matters = false},
        s.steps);
  visit({.name = "checkpoint_seconds",
         .help = "also write a checkpoint after so many seconds. 0: by steps alone",
         .range = kNotNegative,
         .decides = false,
         .matters = false},
        s.seconds);
}

/// Tells when the next checkpoint is due.
class CheckpointTimer {
 public:
  /// The clock starts here.
  explicit CheckpointTimer(const CheckpointInterval& interval) : interval_(interval) {}

  /// Whether one is due after `step` steps; the clock then starts anew.
  bool due(std::int64_t step) {
    const bool late = interval_.seconds > 0 && seconds_since(last_) >= interval_.seconds;
    if (!late && step % interval_.steps != 0) return false;
    last_ = Clock::now();
    return true;
  }

 private:
  CheckpointInterval interval_;
  Clock::time_point last_ = Clock::now();
};

// The schedule of a training: how long it goes on, at which rate, and when its state is written.

/// The settings of every training, whatever learns (base/training_loop.h).
struct TrainingSchedule {
  std::filesystem::path out;  ///< holds the run's state and its result
  std::int64_t steps = 4000;
  int batch = 2;
  double learning_rate = 2e-3;  ///< peak of one_cycle_rate()
  double minutes = 0;           ///< > 0: the schedule ends after them or at `steps`, whichever is first
  CheckpointInterval checkpoint{250};
  std::size_t frames = 0;  ///< only the first N (0: all)
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: as set by set_thread_count
  bool quiet = false;
  /// Asked after every step; true ends the run with a checkpoint, and throws Interrupted.
  std::function<bool()> stop = interrupted;
};

/// `frames` is not part of the identity: the trainer states which frames it used.
template <class Visitor, FieldsOf<TrainingSchedule> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "steps", .help = "updates of the model", .range = kFromOne}, s.steps);
  visit({.name = "batch", .help = "samples per update", .range = kFromOne}, s.batch);
  visit({.name = "learning_rate", .help = "peak of the one-cycle schedule", .range = kPositive},
        s.learning_rate);
  visit({.name = "minutes",
         .help = "end the schedule after this many minutes (0: no limit)",
         .range = kNotNegative,
         .lacking = "0"},
        s.minutes);
  visit_fields(visit, s.checkpoint);
  visit({.name = "frames", .help = "only the first N frames (0: all)", .decides = false}, s.frames);
  visit({.name = "seed", .option = ""}, s.seed);  // every command has one
}

/// Learning rate at `progress` in [0, 1]: a linear rise over the first 5 %, then half a cosine down to 1 % of
/// the peak.
inline double one_cycle_rate(double peak, double progress) {
  constexpr double rise = 0.05, floor = 0.01;
  progress = std::clamp(progress, 0.0, 1.0);
  if (progress < rise) return peak * (0.05 + 0.95 * progress / rise);
  const double along = (progress - rise) / (1 - rise);
  return peak * (floor + (1 - floor) * 0.5 * (1 + std::cos(std::numbers::pi * along)));
}

}  // namespace mirage
