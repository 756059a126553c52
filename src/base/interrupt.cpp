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

struct sigaction before {};  // of InterruptWatch

void on_watched_signal(int signal) {
  if (signals_seen) {
    sigaction(signal, &before, nullptr);
    std::raise(signal);
  }
  signals_seen = 1;
}

}  // namespace

InterruptWatch::InterruptWatch() {
  struct sigaction own {};
  own.sa_handler = on_watched_signal;
  sigemptyset(&own.sa_mask);
  sigaction(SIGINT, &own, &before);
}

InterruptWatch::~InterruptWatch() {
  sigaction(SIGINT, &before, nullptr);
  signals_seen = 0;
}

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
