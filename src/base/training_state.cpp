#include "base/training_state.h"

#include <algorithm>
#include <limits>
#include <sstream>
#include <string>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/provenance.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kMostSteps = 1'000'000'000'000;

std::string weights_name(std::int64_t step) {
  return "checkpoint-" + std::to_string(step) + ".weights";
}

fs::path state_file(const fs::path& out) {
  return out / "training.json";
}

}  // namespace

TrainingState read_training_state(const fs::path& out, const RunIdentity& wanted) {
  TrainingState state;
  const fs::path file = state_file(out);
  if (!fs::exists(file)) return state;
  const nlohmann::json whole = read_json(file, kLargestRecord);
  const JsonFields json(file, whole, "restore the file, or use another --out");
  json.object("options");
  nlohmann::json written = whole.at("options");
  complete(written, wanted.lacking);
  if (written != wanted.json)
    throw InputError(file.string(), "options", "this folder holds a run with other options",
                     "use the same options to go on, or another --out");
  constexpr double kAny = std::numeric_limits<double>::max();
  if (json.has("program") && json.text("program") != program_identity())
    spdlog::warn(
        "{}: the steps so far were made by another program or on another processor; for a run of one start "
        "in another --out",
        file.string());
  state.step = json.integer("step", 0, wanted.json.value("steps", kMostSteps));
  state.seconds = json.number("seconds", 0, kAny);
  const auto losses = json.numbers("losses", state.losses.size(), -kAny, kAny);
  std::copy(losses.begin(), losses.end(), state.losses.begin());
  const std::string weights = json.text("weights");
  // It is removed when the next one is written: no other file may be named.
  if (weights != weights_name(state.step))
    json.fail("weights", "is not this step's " + weights_name(state.step));
  state.weights = out / weights;
  return state;
}

void follow_losses(TrainingState& state, const std::array<double, 3>& now, double share) {
  share = std::max(share, 1.0 / static_cast<double>(state.step + 1));
  for (std::size_t t = 0; t < now.size(); ++t) state.losses[t] += share * (now[t] - state.losses[t]);
}

void write_training_state(const fs::path& out, const nlohmann::json& wanted, TrainingState& state,
                          const std::function<void(const fs::path&)>& save) {
  const fs::path weights = out / weights_name(state.step);
  save(weights);
  write_json(state_file(out), {{"options", wanted},
                               {"program", program_identity()},
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
  std::istringstream lines(read_text(file_, kLargestJson));
  for (std::string line; std::getline(lines, line);) {
    if (line.size() > kLargestRecord) continue;
    const auto json = nlohmann::json::parse(line, nullptr, false);
    const auto at = json.find("step");  // of an object
    if (at != json.end() && at->is_number_integer() && at->get<std::int64_t>() <= step) text_ += line + "\n";
  }
}

void TrainingLog::add(const nlohmann::json& line) {
  text_ += json_text(line) + "\n";
  write_file(file_, text_);
}

}  // namespace mirage
