// base/interrupt.h for a host with signal handlers of its own (Python).
#pragma once

namespace mirage {

/// As watch_for_interrupt(), for Ctrl-C alone and for as long as the object lives: then the host's handler is
/// put back, and what came is forgotten. A second Ctrl-C is the host's. One at a time.
class InterruptWatch {
 public:
  InterruptWatch();
  ~InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
};

}  // namespace mirage
