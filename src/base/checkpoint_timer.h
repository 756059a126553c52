// When a long run writes its state: by steps, and by time.
#pragma once

#include <cstdint>

#include "base/clock.h"
#include "base/fields.h"

namespace mirage {

/// What a run loses to a kill at most, and what its checkpoints cost it.
struct CheckpointInterval {
  std::int64_t steps = 1;  ///< ≥ 1
  double seconds = 0;      ///< > 0: also where so many seconds have passed since the last checkpoint
};

/// Of no identity: how often the state is written does not change the result.
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

}  // namespace mirage
