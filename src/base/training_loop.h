// The state of a training run on disk: OUT/training.json and the weights it names,
// OUT/checkpoint-STEP.weights.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <future>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "base/json_fields.h"
#include "base/schedule.h"

namespace mirage {

/// The progress of a training.
struct TrainingState {
  std::int64_t step = 0;
  double seconds = 0;              ///< spent in earlier runs too
  std::array<double, 3> losses{};  ///< running means of the loss terms
  std::filesystem::path weights;   ///< of the checkpoint; empty: none yet
};

/// The state of the run in `out`; a fresh state without a run. InputError if it has other options than
/// `expected` or is unreadable.
TrainingState read_training_state(const std::filesystem::path& out, const RunIdentity& expected);

/// Writes the weights by save(file), then the state that names them, then removes the old weights: a kill at
/// any point leaves a matching pair.
void write_training_state(const std::filesystem::path& out, const nlohmann::json& expected,
                          TrainingState& state,
                          const std::function<void(const std::filesystem::path&)>& save);

/// OUT/training.jsonl: one JSON object a line, each with its "step". A run that goes on drops the lines past
/// its checkpoint.
class TrainingLog {
 public:
  /// The log of the run in `out`, which goes on from `step`: later lines are dropped.
  TrainingLog(const std::filesystem::path& out, std::int64_t step);
  /// Appends a line; the file is complete at any time.
  void add(const nlohmann::json& line);

 private:
  std::filesystem::path file_;
  std::string text_;
};

// The loop of every training: rate, running losses, checkpoints, going on after a stop. The trainer supplies
// the learning as functions.

/// The parts of the loop that differ between trainings.
struct TrainingWork {
  const char* name = "train";  ///< of the progress line
  /// Share by which a step moves the running losses, but at the start 1 / (steps so far + 1).
  double follow = 0.02;
  std::int64_t report_every = 50;  ///< steps
  /// Makes update `step` (from 0) at learning rate `rate`; returns its three loss terms.
  std::function<std::array<double, 3>(std::int64_t step, double rate)> learn;
  /// Writes the weights and the optimiser's state, so that the next `learn` is the same after a restart.
  std::function<void(const std::filesystem::path& weights)> save;
  /// Removes files that `save` wrote beside the weights at that step, once a newer checkpoint is complete.
  /// May be empty.
  std::function<void(std::int64_t step)> drop = {};
  /// The progress line's note on the losses.
  std::function<std::string()> note;
  /// Reports the step just made; called every report_every steps.
  std::function<void(double rate)> report;
  /// Called every validate_every steps (0: never) before the last, after a checkpoint.
  std::int64_t validate_every = 0;
  std::function<void()> validate = {};
};

/// One run of a training, which lives in schedule.out.
class TrainingLoop {
 public:
  /// Reads the state of the run in schedule.out. InputError if it has another identity or is unreadable.
  TrainingLoop(const TrainingSchedule& schedule, const RunIdentity& identity);

  /// The run's state. If it goes_on(), the trainer loads state().weights before run().
  const TrainingState& state() const { return state_; }
  /// Whether the run goes on from a checkpoint.
  bool goes_on() const { return !state_.weights.empty(); }
  /// Appends the line to OUT/training.jsonl, with "step" and "seconds".
  void log(nlohmann::json line);
  /// Runs to the end of the schedule and writes a last checkpoint; returns this process's seconds a step (0
  /// without a step). It also writes checkpoints as scheduled, before a validation, and when schedule.stop()
  /// is true; then it throws Interrupted.
  double run(const TrainingWork& work);

 private:
  /// Share of the schedule that is done, by steps or by time.
  double progress() const;
  void checkpoint(const TrainingWork& work);

  TrainingSchedule schedule_;
  nlohmann::json identity_;
  TrainingState state_;
  TrainingLog log_;
  std::optional<std::int64_t> kept_;  ///< step of the checkpoint on disk
};

/// Prepares the samples of a step on another thread while the previous step learns.
template <class Samples>
class SamplePrefetcher {
 public:
  /// prepare(step) runs on one thread at a time; its last call is for the step after the last one taken.
  explicit SamplePrefetcher(std::function<Samples(std::int64_t step)> prepare)
      : prepare_(std::move(prepare)) {}
  SamplePrefetcher(const SamplePrefetcher&) = delete;  // its thread refers to it
  SamplePrefetcher& operator=(const SamplePrefetcher&) = delete;
  /// The samples of `step`: any step first, then consecutive ones. Throws as prepare.
  Samples take(std::int64_t step) {
    if (!next_.valid()) begin(step);
    Samples samples = next_.get();
    begin(step + 1);
    return samples;
  }

 private:
  void begin(std::int64_t step) {
    next_ = std::async(std::launch::async, [this, step] { return prepare_(step); });
  }
  std::function<Samples(std::int64_t)> prepare_;
  std::future<Samples> next_;  ///< last member: its destructor waits for the thread
};

}  // namespace mirage
