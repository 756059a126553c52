#include "detection/training.h"

#include <algorithm>
#include <chrono>
#include <future>

#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/progress.h"
#include "base/schedule.h"
#include "detection/training_data.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// What must agree for a run to go on.
nlohmann::json identity(const TrainingOptions& options, std::size_t frames) {
  return {{"detector", options.detector},
          {"data", fs::absolute(options.data).lexically_normal().string()},
          {"steps", options.steps},
          {"batch", options.batch},
          {"learning_rate", options.learning_rate},
          {"minutes", options.minutes},
          {"seed", options.seed},
          {"frames", frames}};
}

struct State {
  std::int64_t step = 0;
  double seconds = 0;  // spent in earlier runs too
  TrainingLoss loss;   // running mean
  fs::path weights;    // of the checkpoint
};

fs::path state_file(const TrainingOptions& options) {
  return options.out / "training.json";
}

State read_state(const TrainingOptions& options, const nlohmann::json& wanted) {
  State state;
  const fs::path file = state_file(options);
  if (!fs::exists(file)) return state;
  const nlohmann::json json = read_json(file);
  try {
    if (json.at("options") != wanted)
      throw InputError(file.string(), "options", "this folder holds a run with other options",
                       "use the same options to go on, or another --out");
    state.step = json.at("step");
    state.seconds = json.at("seconds");
    state.loss = {json.at("loss"), json.at("score_loss"), json.at("box_loss")};
    state.weights = options.out / json.at("weights").get<std::string>();
  } catch (const nlohmann::json::exception& problem) {
    throw InputError(file.string(), "", std::string("not a training state (") + problem.what() + ")",
                     "use another --out");
  }
  return state;
}

/// The weights first, then the state that names them, then the old weights go: a kill at any point leaves a
/// pair.
void write_checkpoint(Detector& detector, const TrainingOptions& options, const nlohmann::json& wanted,
                      State& state) {
  const fs::path weights = options.out / ("checkpoint-" + std::to_string(state.step) + ".weights");
  detector.save(weights, true);
  write_json(state_file(options), {{"options", wanted},
                                   {"step", state.step},
                                   {"seconds", state.seconds},
                                   {"loss", state.loss.total},
                                   {"score_loss", state.loss.score},
                                   {"box_loss", state.loss.box},
                                   {"weights", weights.filename().string()}});
  std::error_code ignored;
  if (!state.weights.empty() && state.weights != weights) fs::remove(state.weights, ignored);
  state.weights = weights;
}

void follow(TrainingLoss& mean, const TrainingLoss& now, std::int64_t step) {
  const double share = std::max(0.02, 1.0 / static_cast<double>(step + 1));
  mean.total += share * (now.total - mean.total);
  mean.score += share * (now.score - mean.score);
  mean.box += share * (now.box - mean.box);
}

}  // namespace

TrainingResult train_detector(const TrainingOptions& options) {
  if (options.steps < 1) throw InputError("--steps", "", "must be at least 1", "give a positive number");
  if (options.batch < 1) throw InputError("--batch", "", "must be at least 1", "give a positive number");
  if (!(options.learning_rate > 0)) throw InputError("--learning-rate", "", "must be positive", "try 0.002");
  make_output_folder(options.out);
  std::array<double, 4> region{};
  DetectorOptions load{options.detector, {}, true, options.seed, options.threads};
  auto detector = load_detector(load);
  region = detector->region();
  TrainingData data(options.data, options.frames, region, options.seed);
  const nlohmann::json wanted = identity(options, data.size());
  State state = read_state(options, wanted);
  if (!state.weights.empty()) {
    load.fresh = false;
    load.weights = state.weights;
    detector = load_detector(load);
    spdlog::info("going on from step {} of {}", state.step, options.steps);
  }

  const auto progress_now = [&] {
    const double by_steps = static_cast<double>(state.step) / static_cast<double>(options.steps);
    return options.minutes > 0 ? std::max(by_steps, state.seconds / (60 * options.minutes)) : by_steps;
  };
  const double seconds_before = state.seconds;
  const std::int64_t first_step = state.step;
  const auto start = Clock::now();
  auto next =
      std::async(std::launch::async, [&, step = state.step] { return data.prepare(step, options.batch); });
  {
    Progress progress("train", static_cast<std::size_t>(options.steps), options.quiet);
    while (progress_now() < 1) {
      const std::vector<PreparedSample> samples = next.get();
      next = std::async(std::launch::async,
                        [&, step = state.step + 1] { return data.prepare(step, options.batch); });
      std::vector<TrainingSample> views;
      for (const PreparedSample& sample : samples) views.push_back(sample.view());
      const double rate = one_cycle(options.learning_rate, progress_now());
      follow(state.loss, detector->train_step(views, rate), state.step);
      ++state.step;
      state.seconds = seconds_before + seconds_since(start);
      progress.update(static_cast<std::size_t>(state.step),
                      fmt::format("loss {:.3f} (score {:.3f}, box {:.3f})", state.loss.total,
                                  state.loss.score, state.loss.box));
      if (state.step % 100 == 0)
        spdlog::info("step {} rate {:.2e} loss {:.4f} score {:.4f} box {:.4f} {:.0f} s", state.step, rate,
                     state.loss.total, state.loss.score, state.loss.box, state.seconds);
      const bool stop = interrupted();
      if (stop || state.step % options.checkpoint_every == 0)
        write_checkpoint(*detector, options, wanted, state);
      if (stop) throw Interrupted("interrupted; the checkpoint is kept, the same command goes on from it");
    }
  }
  next.wait();

  TrainingResult result;
  result.steps = state.step;
  result.seconds = state.seconds;
  result.seconds_per_step =
      state.step > first_step ? seconds_since(start) / static_cast<double>(state.step - first_step) : 0;
  result.loss = state.loss;
  result.weights = options.out / (options.detector + ".weights");
  write_checkpoint(*detector, options, wanted, state);
  detector->save(result.weights, false);
  if (!options.validation.empty()) {
    const DetectionRun run = detect_data_set(*detector, options.validation, options.validation_frames);
    result.validated = true;
    result.at50 = run.at50;
    result.at70 = run.at70;
  }
  return result;
}

}  // namespace mirage
