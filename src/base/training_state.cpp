#include "base/training_state.h"

#include <algorithm>
#include <sstream>
#include <string>

#include "base/error.h"
#include "base/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

fs::path state_file(const fs::path& out) {
  return out / "training.json";
}

}  // namespace

TrainingState read_training_state(const fs::path& out, const nlohmann::json& wanted) {
  TrainingState state;
  const fs::path file = state_file(out);
  if (!fs::exists(file)) return state;
  const nlohmann::json json = read_json(file);
  try {
    if (json.at("options") != wanted)
      throw InputError(file.string(), "options", "this folder holds a run with other options",
                       "use the same options to go on, or another --out");
    state.step = json.at("step");
    state.seconds = json.at("seconds");
    state.losses = json.at("losses");
    state.weights = out / json.at("weights").get<std::string>();
  } catch (const nlohmann::json::exception& problem) {
    throw InputError(file.string(), "", std::string("not a training state (") + problem.what() + ")",
                     "use another --out");
  }
  return state;
}

void follow_losses(TrainingState& state, const std::array<double, 3>& now, double share) {
  share = std::max(share, 1.0 / static_cast<double>(state.step + 1));
  for (std::size_t t = 0; t < now.size(); ++t) state.losses[t] += share * (now[t] - state.losses[t]);
}

void write_training_state(const fs::path& out, const nlohmann::json& wanted, TrainingState& state,
                          const std::function<void(const fs::path&)>& save) {
  const fs::path weights = out / ("checkpoint-" + std::to_string(state.step) + ".weights");
  save(weights);
  write_json(state_file(out), {{"options", wanted},
                               {"step", state.step},
                               {"seconds", state.seconds},
                               {"losses", state.losses},
                               {"weights", weights.filename().string()}});
  std::error_code ignored;
  if (!state.weights.empty() && state.weights != weights) fs::remove(state.weights, ignored);
  state.weights = weights;
}

TrainingLog::TrainingLog(const fs::path& out, std::int64_t step) : file_(out / "training.jsonl") {
  if (step == 0 || !fs::exists(file_)) return;
  std::istringstream lines(read_file(file_));
  for (std::string line; std::getline(lines, line);) {
    const auto json = nlohmann::json::parse(line, nullptr, false);
    if (json.is_object() && json.value("step", step + 1) <= step) text_ += line + "\n";
  }
}

void TrainingLog::add(const nlohmann::json& line) {
  text_ += line.dump() + "\n";
  write_file(file_, text_);
}

}  // namespace mirage
