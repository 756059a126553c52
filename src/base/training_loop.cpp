#include "base/training_loop.h"

#include <algorithm>
#include <limits>
#include <sstream>
#include <utility>

#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/provenance.h"
#include "base/sizes.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kMaxSteps = 1'000'000'000'000;

std::string weights_name(std::int64_t step) {
  return "checkpoint-" + std::to_string(step) + ".weights";
}

fs::path state_file(const fs::path& out) {
  return out / "training.json";
}

}  // namespace

TrainingState read_training_state(const fs::path& out, const RunIdentity& expected) {
  TrainingState state;
  const fs::path file = state_file(out);
  if (!fs::exists(file)) return state;
  const nlohmann::json whole = read_json(file, kMaxRecordBytes);
  const JsonFields json(file, whole, "restore the file, or use another --out");
  json.object("options");
  nlohmann::json written = whole.at("options");
  complete(written, expected.lacking);
  if (written != expected.json)
    throw InputError(file.string(), "options", "this folder holds a run with other options",
                     "use the same options to go on, or another --out");
  constexpr double kAny = std::numeric_limits<double>::max();
  if (json.has("program") && json.text("program") != program_identity())
    spdlog::warn(
        "{}: the steps so far were made by another version of Mirage or on another processor; to repeat all "
        "of them with this one, use another --out",
        file.string());
  state.step = json.integer("step", 0, expected.json.value("steps", kMaxSteps));
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

void write_training_state(const fs::path& out, const nlohmann::json& expected, TrainingState& state,
                          const std::function<void(const fs::path&)>& save) {
  const fs::path weights = out / weights_name(state.step);
  save(weights);
  write_json(state_file(out), {{"options", expected},
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
  std::istringstream lines(read_text(file_, kMaxJsonBytes));
  for (std::string line; std::getline(lines, line);) {
    if (line.size() > kMaxRecordBytes) continue;
    const auto json = nlohmann::json::parse(line, nullptr, false);
    const auto at = json.find("step");  // of an object
    if (at != json.end() && at->is_number_integer() && at->get<std::int64_t>() <= step) text_ += line + "\n";
  }
}

void TrainingLog::add(const nlohmann::json& line) {
  text_ += json_text(line) + "\n";
  write_file(file_, text_);
}

TrainingLoop::TrainingLoop(const TrainingSchedule& schedule, const RunIdentity& identity)
    : schedule_(schedule),
      identity_(identity.json),
      state_(read_training_state(schedule.out, identity)),
      log_(schedule.out, state_.step) {
  if (goes_on()) kept_ = state_.step;
}

void TrainingLoop::log(nlohmann::json line) {
  line["step"] = state_.step;
  line["seconds"] = state_.seconds;
  log_.add(line);
}

double TrainingLoop::progress() const {
  const double by_steps = static_cast<double>(state_.step) / static_cast<double>(schedule_.steps);
  return schedule_.minutes > 0 ? std::max(by_steps, state_.seconds / (60 * schedule_.minutes)) : by_steps;
}

void TrainingLoop::checkpoint(const TrainingWork& work) {
  write_training_state(schedule_.out, identity_, state_, work.save);
  if (const auto earlier = std::exchange(kept_, state_.step); work.drop && earlier && earlier != kept_)
    work.drop(*earlier);
}

double TrainingLoop::run(const TrainingWork& work) {
  if (goes_on()) spdlog::info("going on from step {} of {}", state_.step, schedule_.steps);
  const double seconds_before = state_.seconds;
  const std::int64_t first = state_.step;
  const auto start = Clock::now();
  CheckpointTimer timer(schedule_.checkpoint);
  {
    Progress shown(work.name, as_size(schedule_.steps), schedule_.quiet);
    while (progress() < 1) {
      const double rate = one_cycle_rate(schedule_.learning_rate, progress());
      const std::array<double, 3> losses = work.learn(state_.step, rate);
      const double share = std::max(work.follow, 1.0 / static_cast<double>(state_.step + 1));
      for (std::size_t t = 0; t < losses.size(); ++t)
        state_.losses[t] += share * (losses[t] - state_.losses[t]);
      ++state_.step;
      state_.seconds = seconds_before + seconds_since(start);
      shown.update(as_size(state_.step), work.note());
      if (state_.step % work.report_every == 0) work.report(rate);
      const bool stop = schedule_.stop();
      const bool validate =
          work.validate_every > 0 && state_.step % work.validate_every == 0 && state_.step < schedule_.steps;
      if (const bool due = timer.due(state_.step); stop || validate || due) checkpoint(work);
      if (stop) throw Interrupted("interrupted; a checkpoint is saved, run the same command again to resume");
      if (validate) work.validate();
    }
  }
  const auto steps = static_cast<double>(state_.step - first);
  const double seconds_per_step = steps > 0 ? seconds_since(start) / steps : 0;
  checkpoint(work);
  return seconds_per_step;
}

}  // namespace mirage
