// The state of a training run on disk: OUT/training.json and the weights it names,
// OUT/checkpoint-STEP.weights.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "base/field_json.h"

namespace mirage {

/// Where a training stands.
struct TrainingState {
  std::int64_t step = 0;
  double seconds = 0;              ///< spent in earlier runs too
  std::array<double, 3> losses{};  ///< running means of the loss terms
  std::filesystem::path weights;   ///< of the checkpoint; empty: none yet
};

/// The run in `out` (a fresh state when there is none). InputError if it is of other options than `wanted`,
/// or unreadable.
TrainingState read_training_state(const std::filesystem::path& out, const RunIdentity& wanted);

/// Moves the running means towards `now`, by `share` or, at the start, by 1 / (steps so far + 1).
void follow_losses(TrainingState& state, const std::array<double, 3>& now, double share);

/// save(file) writes the weights, then the state that names them is written, then the old weights go: a kill
/// at any point leaves a pair.
void write_training_state(const std::filesystem::path& out, const nlohmann::json& wanted,
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

}  // namespace mirage
