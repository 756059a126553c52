#include "base/training_loop.h"

#include <algorithm>
#include <utility>

#include "base/checkpoint_timer.h"
#include "base/clock.h"
#include "base/error.h"
#include "base/logging.h"
#include "base/progress.h"

namespace mirage {

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
    Progress shown(work.name, static_cast<std::size_t>(schedule_.steps), schedule_.quiet);
    while (progress() < 1) {
      const double rate = one_cycle(schedule_.learning_rate, progress());
      follow_losses(state_, work.learn(state_.step, rate), work.follow);
      ++state_.step;
      state_.seconds = seconds_before + seconds_since(start);
      shown.update(static_cast<std::size_t>(state_.step), work.note());
      if (state_.step % work.tell_every == 0) work.tell(rate);
      const bool stop = schedule_.stop();
      const bool validate =
          work.validate_every > 0 && state_.step % work.validate_every == 0 && state_.step < schedule_.steps;
      if (const bool due = timer.due(state_.step); stop || validate || due) checkpoint(work);
      if (stop) throw Interrupted("interrupted; the checkpoint is kept, the same command goes on from it");
      if (validate) work.validate();
    }
  }
  const auto steps = static_cast<double>(state_.step - first);
  const double seconds_per_step = steps > 0 ? seconds_since(start) / steps : 0;
  checkpoint(work);
  return seconds_per_step;
}

}  // namespace mirage
