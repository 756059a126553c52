// Ctrl-C and SIGTERM set a flag; long loops look at it between units of work.
#pragma once

namespace mirage {

/// Installs the handlers. A second signal ends the process at once.
void watch_for_interrupt();
/// True once a signal has come.
bool interrupted();
/// Throws Interrupted with a text that says that `kept` is safe, if a signal has come.
void throw_if_interrupted(const char* kept);

// base/interrupt.h for a host with signal handlers of its own (Python).

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
