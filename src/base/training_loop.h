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

/// Where a training stands.
struct TrainingState {
  std::int64_t step = 0;
  double seconds = 0;              ///< spent in earlier runs too
  std::array<double, 3> losses{};  ///< running means of the loss terms
  std::filesystem::path weights;   ///< of the checkpoint; empty: none yet
};

/// The run in `out` (a fresh state when there is none). InputError if it is of other options than `expected`,
/// or unreadable.
TrainingState read_training_state(const std::filesystem::path& out, const RunIdentity& expected);

/// save(file) writes the weights, then the state that names them is written, then the old weights go: a kill
/// at any point leaves a pair.
void write_training_state(const std::filesystem::path& out, const nlohmann::json& expected,
                          TrainingState& state,
                          const std::function<void(const std::filesystem::path&)>& save);

/// OUT/training.jsonl: one JSON object a line, each with its "step". A run that goes on drops the lines past
/// its checkpoint.
class TrainingLog {
 public:
  /// Of the run in `out` that goes on from `step`: later lines are dropped.
  TrainingLog(const std::filesystem::path& out, std::int64_t step);
  /// Appends a line; the file is whole at any time.
  void add(const nlohmann::json& line);

 private:
  std::filesystem::path file_;
  std::string text_;
};

// The loop of every training: rate, running losses, checkpoints, going on after a stop. What learns is the
// trainer's, and comes as functions.

/// What one training does where all of them do something.
struct TrainingWork {
  const char* name = "train";  ///< of the progress line
  /// Share by which a step moves the running losses, but at the start 1 / (steps so far + 1).
  double follow = 0.02;
  std::int64_t report_every = 50;  ///< steps
  /// The update number `step`, from 0, at this rate; returns its three loss terms.
  std::function<std::array<double, 3>(std::int64_t step, double rate)> learn;
  /// Writes the weights and the optimiser's state, so that the next `learn` is the same after a start anew.
  std::function<void(const std::filesystem::path& weights)> save;
  /// Removes what `save` wrote beside the weights at that step: a newer checkpoint is whole. May be empty.
  std::function<void(std::int64_t step)> drop = {};
  /// What the progress line says of the losses.
  std::function<std::string()> note;
  /// Tells of the step just done; every report_every steps.
  std::function<void(double rate)> report;
  /// Called every validate_every steps (0: never) before the last, after a checkpoint.
  std::int64_t validate_every = 0;
  std::function<void()> validate = {};
};

/// One run of a training, which lives in schedule.out.
class TrainingLoop {
 public:
  /// Reads the state of the run in schedule.out. InputError if that is a run of another identity, or
  /// unreadable.
  TrainingLoop(const TrainingSchedule& schedule, const RunIdentity& identity);

  /// Where the run stands. Where it `goes_on`, the trainer loads state().weights before run().
  const TrainingState& state() const { return state_; }
  /// Whether the run goes on from a checkpoint.
  bool goes_on() const { return !state_.weights.empty(); }
  /// Appends the line to OUT/training.jsonl, with "step" and "seconds".
  void log(nlohmann::json line);
  /// Goes on to the end of the schedule and writes a last checkpoint; returns this process's seconds a step
  /// (0 without a step). Checkpoints are also written as the schedule asks, before a validation and where
  /// schedule.stop() says so, which throws Interrupted.
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

/// Samples of a step, prepared by a thread of their own while the step before learns.
template <class Samples>
class SamplePrefetcher {
 public:
  /// prepare(step) runs in one thread at a time, and at last for the step after the last one taken.
  explicit SamplePrefetcher(std::function<Samples(std::int64_t step)> prepare)
      : prepare_(std::move(prepare)) {}
  SamplePrefetcher(const SamplePrefetcher&) = delete;  // its thread knows it
  SamplePrefetcher& operator=(const SamplePrefetcher&) = delete;
  /// Those of `step`: of any, then of one after the other. Throws what prepare throws.
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
  std::future<Samples> next_;  ///< last: its end waits for the thread
};

}  // namespace mirage
