// Log lines go to standard error through spdlog; results go to standard output.
#pragma once

#include <spdlog/spdlog.h>

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

namespace mirage {

/// Sets the pattern and the level (quiet: warnings and errors only).
void start_logging(bool quiet);
/// From now on start_logging is always quiet, or no longer: for a program that shows results itself.
void keep_logging_quiet(bool quiet);

/// A progress line with an estimate of the time left, on standard error, only on a terminal; it disappears
/// with the object.
class Progress {
 public:
  /// `what` names the work ("attack"), `total` its units. `quiet` (or no terminal) prints nothing.
  Progress(std::string what, std::size_t total, bool quiet = false);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// `done` units are finished; `note` is shown after the estimate ("loss 0.31").
  void update(std::size_t done, const std::string& note = "");
  /// Adds `more` finished units. Several threads may call it.
  void add(std::size_t more = 1, const std::string& note = "");

 private:
  std::string what_;
  std::size_t total_, first_ = 0, done_ = 0;
  std::mutex adding_;
  bool shown_, started_ = false;
  std::chrono::steady_clock::time_point start_, last_;
};

/// A callback that shows the progress of work that reports units done and units in all. The line disappears
/// with the callback.
inline std::function<void(std::size_t, std::size_t)> progress_of(const char* what, bool quiet) {
  return [what, quiet, progress = std::shared_ptr<Progress>()](std::size_t done, std::size_t total) mutable {
    if (!progress) progress = std::make_shared<Progress>(what, total, quiet);
    progress->update(done);
  };
}

/// Receives the work's name, units done, units in all, the time left ("1:23"), and a note.
using ProgressListener =
    std::function<void(const std::string&, std::size_t, std::size_t, const std::string&, const std::string&)>;

/// As long as it lives, progress is told to the listener, quiet or not, ten times a second at most, on the
/// thread that does the work; nothing is printed. One at a time.
class ProgressListenerScope {
 public:
  /// Sends progress to the listener from now on.
  explicit ProgressListenerScope(ProgressListener listener);
  ~ProgressListenerScope();
  ProgressListenerScope(const ProgressListenerScope&) = delete;
  ProgressListenerScope& operator=(const ProgressListenerScope&) = delete;
};

}  // namespace mirage
