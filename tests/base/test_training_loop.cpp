// The loop of every training, with a model of two numbers. It resumes after any stop to the same bits, ends
// by time, and writes its state when due.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <sstream>
#include <thread>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/random.h"
#include "base/sizes.h"
#include "base/training_loop.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::ElementsAre;

/// A number that follows random samples with momentum, and a record of its training.
struct Toy {
  double weight = 1, momentum = 0;
  std::vector<std::pair<std::int64_t, double>> steps = {};  ///< number and rate of each
  std::vector<std::int64_t> saved = {}, dropped = {}, validated = {};
  double seconds_per_step = 0;
  TrainingState state = {};
};

nlohmann::json identity(const TrainingSchedule& schedule) {
  return {{"steps", schedule.steps}};
}

/// Trains the toy or resumes; `nap`: extra time per step.
void train(const TrainingSchedule& schedule, Toy& toy, std::int64_t validate_every = 0,
           std::chrono::milliseconds nap = {}) {
  TrainingLoop loop(schedule, identity(schedule));
  if (loop.goes_on()) {
    const nlohmann::json stored = read_json(loop.state().weights);
    toy.weight = stored.at("weight"), toy.momentum = stored.at("momentum");
  }
  SamplePrefetcher<double> ahead([&](std::int64_t step) {
    return RandomStream(schedule.seed, "toy samples", static_cast<std::uint64_t>(step)).uniform(-1, 1);
  });
  TrainingWork work;
  work.report_every = 2;
  work.learn = [&](std::int64_t step, double rate) {
    std::this_thread::sleep_for(nap);
    const double away = toy.weight - ahead.take(step);
    toy.momentum = 0.9 * toy.momentum + away;
    toy.weight -= rate * toy.momentum;
    toy.steps.emplace_back(step, rate);
    return std::array{away * away, away, toy.momentum};
  };
  const auto beside = [&](std::int64_t step) { return schedule.out / ("beside-" + std::to_string(step)); };
  work.save = [&](const std::filesystem::path& file) {
    toy.saved.push_back(loop.state().step);
    write_file(beside(loop.state().step), "");
    write_json(file, {{"weight", toy.weight}, {"momentum", toy.momentum}});
  };
  work.drop = [&](std::int64_t step) {
    toy.dropped.push_back(step);
    std::filesystem::remove(beside(step));
  };
  work.note = [] { return std::string(); };
  work.report = [&](double rate) { loop.log({{"rate", rate}, {"loss", loop.state().losses[0]}}); };
  work.validate_every = validate_every;
  work.validate = [&] {
    EXPECT_EQ(toy.saved.back(), loop.state().step);
    toy.validated.push_back(loop.state().step);
  };
  toy.seconds_per_step = loop.run(work);
  toy.state = loop.state();
}

TrainingSchedule schedule_in(const std::filesystem::path& out, std::int64_t steps) {
  TrainingSchedule schedule;
  schedule.out = out;
  schedule.steps = steps;
  schedule.seed = 3;
  schedule.quiet = true;
  schedule.stop = [] { return false; };
  make_output_folder(out);
  return schedule;
}

std::vector<std::string> names_in(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    names.push_back(entry.path().filename().string());
  return names;
}

/// The file's lines, or the file, without its times.
std::vector<nlohmann::json> without_seconds(const std::filesystem::path& file) {
  std::vector<nlohmann::json> lines;
  std::istringstream text(read_file(file));
  if (file.extension() == ".json") {
    lines.push_back(read_json(file));
  } else {
    for (std::string line; std::getline(text, line);) lines.push_back(nlohmann::json::parse(line));
  }
  for (nlohmann::json& line : lines) EXPECT_EQ(line.erase("seconds"), 1u);
  return lines;
}

TEST(TrainingLoop, GoesOnAfterAnyStopToTheSameBits) {
  const TemporaryFolder folder;
  constexpr std::int64_t kSteps = 9;
  const TrainingSchedule schedule = schedule_in(folder / "whole", kSteps);
  Toy whole;
  train(schedule, whole);
  ASSERT_EQ(whole.steps.size(), as_size(kSteps));
  for (std::int64_t last = 1; last <= kSteps; ++last) {
    TrainingSchedule parts = schedule_in(folder / std::to_string(last), kSteps);
    parts.checkpoint.steps = 4;  // the stop writes its own checkpoint
    parts.stop = [last, step = 0]() mutable { return ++step == last; };
    Toy first;
    EXPECT_THAT(error_text<Interrupted>([&] { train(parts, first); }), testing::HasSubstr("to resume"));
    EXPECT_EQ(first.saved.back(), last);
    parts.stop = [] { return false; };
    Toy second;
    train(parts, second);

    auto steps = first.steps;
    steps.insert(steps.end(), second.steps.begin(), second.steps.end());
    EXPECT_EQ(steps, whole.steps) << last;
    EXPECT_EQ(second.weight, whole.weight) << last;
    EXPECT_EQ(second.state.losses, whole.state.losses) << last;
    for (const char* file : {"training.json", "training.jsonl"})
      EXPECT_EQ(without_seconds(parts.out / file), without_seconds(schedule.out / file)) << last;
    EXPECT_THAT(names_in(parts.out), testing::UnorderedElementsAre("training.json", "training.jsonl",
                                                                   "checkpoint-9.weights", "beside-9"));
  }
}

TEST(TrainingLog, LinesThatAreNoneOfItsAreLeftOut) {
  const TemporaryFolder folder;
  write_file(folder / "training.jsonl",
             "{\"step\":1}\n{\"step\":\"x\"}\n{\"step\":null}\n[1]\n[[[\n3\n{\"step\":3}\n");
  TrainingLog log(folder.path(), 2);
  log.add({{"step", 2}});
  EXPECT_EQ(read_file(folder / "training.jsonl"), "{\"step\":1}\n{\"step\":2}\n");
}

TEST(TrainingLoop, ARunThatIsDoneDoesNothingMore) {
  const TemporaryFolder folder;
  const TrainingSchedule schedule = schedule_in(folder.path(), 3);
  Toy first, again;
  train(schedule, first);
  train(schedule, again);
  EXPECT_TRUE(again.steps.empty());
  EXPECT_EQ(again.seconds_per_step, 0);
  EXPECT_EQ(again.weight, first.weight);
  EXPECT_TRUE(again.dropped.empty());
  TrainingSchedule other = schedule;
  other.steps = 4;
  EXPECT_THAT(error_text<InputError>([&] { train(other, again); }), testing::HasSubstr("other options"));
}

TEST(TrainingLoop, MinutesEndTheSchedule) {
  const TemporaryFolder folder;
  TrainingSchedule schedule = schedule_in(folder.path(), 1'000'000);
  schedule.minutes = 0.02 / 60;
  Toy toy;
  train(schedule, toy, 0, std::chrono::milliseconds(5));
  EXPECT_GE(toy.steps.size(), 1u);
  EXPECT_LE(toy.steps.size(), 4u);
  EXPECT_GE(toy.state.seconds, 0.02);
  EXPECT_GE(toy.seconds_per_step, 0.005);
  EXPECT_THAT(toy.saved, ElementsAre(toy.state.step));
  // Time of earlier runs counts: the limit is already reached.
  Toy again;
  train(schedule, again);
  EXPECT_TRUE(again.steps.empty());
  EXPECT_EQ(again.state.step, toy.state.step);
}

TEST(TrainingLoop, WritesItsStateWhenThatIsDue) {
  const TemporaryFolder folder;
  TrainingSchedule schedule = schedule_in(folder / "steps", 7);
  schedule.checkpoint.steps = 3;
  Toy by_steps;
  train(schedule, by_steps);
  EXPECT_THAT(by_steps.saved, ElementsAre(3, 6, 7));
  EXPECT_THAT(by_steps.dropped, ElementsAre(3, 6));

  schedule = schedule_in(folder / "validated", 6);
  schedule.checkpoint.steps = 3;
  Toy validated;
  train(schedule, validated, 2);
  EXPECT_THAT(validated.validated, ElementsAre(2, 4));  // the trainer itself does the last one
  EXPECT_THAT(validated.saved, ElementsAre(2, 3, 4, 6, 6));
  EXPECT_THAT(validated.dropped, ElementsAre(2, 3, 4));

  schedule = schedule_in(folder / "time", 3);
  schedule.checkpoint.seconds = 1e-3;
  Toy by_time;
  train(schedule, by_time, 0, std::chrono::milliseconds(2));
  EXPECT_THAT(by_time.saved, ElementsAre(1, 2, 3, 3));
}

TEST(TrainingLoop, SamplesThatCannotBeReadEndTheStepThatTakesThem) {
  SamplePrefetcher<std::int64_t> ahead([](std::int64_t step) {
    if (step == 1) throw InputError("frame", "", "is damaged", "mend it");
    return 10 * step;
  });
  EXPECT_EQ(ahead.take(0), 0);
  EXPECT_THROW(ahead.take(1), InputError);
  EXPECT_EQ(ahead.take(2), 20);
}

TEST(TrainingSchedule, ItsFieldsAreCheckedAndTheseDecideTheResult) {
  TrainingSchedule schedule;
  EXPECT_NO_THROW(check_fields(schedule));
  EXPECT_EQ(
      fields_json(schedule),
      nlohmann::json({{"steps", 4000}, {"batch", 2}, {"learning_rate", 2e-3}, {"minutes", 0}, {"seed", 0}}));
  const auto message_of = [](auto change) {
    TrainingSchedule wrong;
    change(wrong);
    return error_text<FieldError>([&] { check_fields(wrong); });
  };
  EXPECT_EQ(message_of([](auto& s) { s.steps = 0; }), "steps: 0: out of range; use at least 1");
  EXPECT_EQ(message_of([](auto& s) { s.batch = -1; }), "batch: -1: out of range; use at least 1");
  EXPECT_EQ(message_of([](auto& s) { s.learning_rate = 0; }), "learning_rate: 0: out of range; use above 0");
  EXPECT_EQ(message_of([](auto& s) { s.checkpoint.steps = 0; }),
            "checkpoint_every: 0: out of range; use at least 1");
}

}  // namespace
}  // namespace mirage
