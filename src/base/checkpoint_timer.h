// When a long run writes its state: by steps, and by time.
#pragma once

#include <cstdint>

#include "base/clock.h"

namespace mirage {

/// What a run loses to a kill at most, and what its checkpoints cost it.
struct CheckpointInterval {
  std::int64_t steps = 1;  ///< ≥ 1
  double seconds = 0;      ///< > 0: also where so many seconds have passed since the last checkpoint
};

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

}  // namespace mirage
