#include "base/error.h"

#include <algorithm>
#include <csignal>
#include <string_view>

#include "base/names.h"

namespace mirage {
namespace {

constexpr std::size_t kMaxPathLength = 4096, kMaxPartLength = 480, kMaxListLength = 2048;

/// The text as errors show it; its middle is left out if it is longer than `most` bytes.
std::string shown(std::string_view part, std::size_t most) {
  if (part.size() <= most) return printable(part);
  // Never cuts within a character: its bytes after the first are 10xxxxxx.
  const auto inside = [&](std::size_t at) { return (static_cast<unsigned char>(part[at]) & 0xc0) == 0x80; };
  std::size_t head = most / 2, tail = part.size() - most / 2;
  while (head > 0 && inside(head)) --head;
  while (tail < part.size() && inside(tail)) ++tail;
  return printable(part.substr(0, head)) + "…" + printable(part.substr(tail));
}

/// A library's message of several lines in one.
std::string without_lines(std::string text) {
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text;
}

std::string line(const std::string& where, const std::string& field, const std::string& problem,
                 const std::string& fix) {
  return (where.empty() ? "\"\"" : shown(where, kMaxPathLength)) + ": " +
         (field.empty() ? "" : shown(field, kMaxPartLength) + ": ") +
         shown(without_lines(problem), kMaxPartLength) + "; " +
         shown(fix, kMaxListLength);  // of all that there is
}

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

InputError::InputError(const std::string& where, const std::string& field, const std::string& problem,
                       const std::string& fix)
    : std::runtime_error(line(where, field, problem, fix)) {}

Failure::Failure(const std::string& where, const std::string& problem, const std::string& fix)
    : std::runtime_error(line(where, "", problem, fix)) {}

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
