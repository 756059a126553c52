// Ctrl-C and SIGTERM set a flag; long loops look at it between units of work.
#pragma once

namespace mirage {

/// Installs the handlers. A second signal ends the process at once.
void watch_for_interrupt();
/// True once a signal has come.
bool interrupted();
/// Throws Interrupted with a text that says that `kept` is safe, if a signal has come.
void throw_if_interrupted(const char* kept);

}  // namespace mirage
