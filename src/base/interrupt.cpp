#include "base/interrupt.h"

#include <csignal>
#include <string>

#include "base/error.h"

namespace mirage {
namespace {

volatile std::sig_atomic_t signals_seen = 0;

void on_signal(int signal) {
  if (signals_seen) {
    std::signal(signal, SIG_DFL);
    std::raise(signal);
  }
  signals_seen = 1;
}

}  // namespace

void watch_for_interrupt() {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
}

bool interrupted() {
  return signals_seen != 0;
}

void throw_if_interrupted(const char* kept) {
  if (interrupted()) throw Interrupted(std::string("interrupted; ") + kept);
}

}  // namespace mirage
