#include "detection/training.h"

#include <algorithm>
#include <future>

#include "base/checkpoint_timer.h"
#include "base/clock.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/progress.h"
#include "base/schedule.h"
#include "base/training_state.h"
#include "detection/precision.h"
#include "detection/training_data.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kLogEvery = 50;  // steps

/// What must agree for a run to go on.
nlohmann::json identity(const TrainingOptions& options, std::size_t frames) {
  nlohmann::json json = {{"detector", options.detector},
                         {"data", escape_name(fs::absolute(options.data).lexically_normal().string())},
                         {"steps", options.steps},
                         {"batch", options.batch},
                         {"learning_rate", options.learning_rate},
                         {"minutes", options.minutes},
                         {"seed", options.seed},
                         {"start", options.start.empty() ? "" : content_hash(read_file(options.start))},
                         {"bfloat16", options.precision == kBfloat16},
                         {"frames", frames}};
  for (const auto& [key, file] : {std::pair("camera", options.camera), std::pair("lidar", options.lidar)})
    if (!file.empty()) json[key] = content_hash(read_file(file));
  if (options.joint) json["joint"] = true;
  if (options.heads) json["heads"] = true;
  if (options.ground_truth_sampling > 0) json["ground_truth_sampling"] = options.ground_truth_sampling;
  if (options.thin_lidar > 0) json["thin_lidar"] = options.thin_lidar;
  return json;
}

nlohmann::json scores(const DetectionRun& run) {
  return {{"ap50", run.at50.average_precision},
          {"ap70", run.at70.average_precision},
          {"recall50", run.at50.recall}};
}

}  // namespace

TrainingResult train_detector(const TrainingOptions& options) {
  if (options.steps < 1) throw InputError("--steps", "", "must be at least 1", "give a positive number");
  if (options.batch < 1) throw InputError("--batch", "", "must be at least 1", "give a positive number");
  if (!(options.learning_rate > 0)) throw InputError("--learning-rate", "", "must be positive", "try 0.002");
  if (options.validate_every > 0 && options.validation.empty())
    throw InputError("--validate-every", "", "needs a data set to validate on", "name it with --validation");
  make_output_folder(options.out);
  DetectorOptions load{options.detector, options.start, options.start.empty(), options.seed, options.threads};
  load.start = !options.start.empty();
  load.precision = options.precision;
  load.camera = options.camera;
  load.lidar = options.lidar;
  if (options.joint && options.heads)
    throw InputError("--heads", "", "trains less than --joint does", "give one of the two");
  if (options.joint) load.parts = {"joint"};
  if (options.heads) load.parts = {"heads"};
  auto detector = load_detector(load);
  if (!(options.ground_truth_sampling >= 0 && options.ground_truth_sampling <= 20))
    throw InputError("--ground-truth-sampling", "", "must be from 0 to 20", "try 2");
  if (!(options.thin_lidar >= 0 && options.thin_lidar <= 1))
    throw InputError("--thin-lidar", "", "must be from 0 to 1", "try 0.5");
  TrainingData data(options.data, options.frames, detector->region(), options.seed,
                    options.ground_truth_sampling, detector->capabilities().reads_image, options.thin_lidar);
  const nlohmann::json wanted = identity(options, data.size());
  TrainingState state = read_training_state(options.out, wanted);
  if (!state.weights.empty()) {
    load.fresh = load.start = false;
    load.camera = load.lidar = "";
    load.weights = state.weights;
    detector = load_detector(load);
    spdlog::info("going on from step {} of {}", state.step, options.steps);
  }

  const auto progress_now = [&] {
    const double by_steps = static_cast<double>(state.step) / static_cast<double>(options.steps);
    return options.minutes > 0 ? std::max(by_steps, state.seconds / (60 * options.minutes)) : by_steps;
  };
  const auto checkpoint = [&] {
    write_training_state(options.out, wanted, state,
                         [&](const fs::path& file) { detector->save(file, true); });
  };
  TrainingLog log(options.out, state.step);
  const auto validate = [&] {
    DetectionRun run = detect_data_set(*detector, options.validation, options.validation_frames);
    nlohmann::json line = scores(run);
    line["step"] = state.step;
    line["seconds"] = state.seconds;
    log.add(line);
    spdlog::info("step {} validation AP50 {:.3f} AP70 {:.3f} recall50 {:.3f}", state.step,
                 run.at50.average_precision, run.at70.average_precision, run.at50.recall);
    return run;
  };
  const double seconds_before = state.seconds;
  const std::int64_t first_step = state.step;
  const auto start = Clock::now();
  CheckpointTimer timer({options.checkpoint_every, options.checkpoint_seconds});
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
      const TrainingLoss loss = detector->train_step(views, rate);
      follow_losses(state, {loss.total, loss.score, loss.box}, 0.02);
      ++state.step;
      state.seconds = seconds_before + seconds_since(start);
      progress.update(static_cast<std::size_t>(state.step),
                      fmt::format("loss {:.3f} (score {:.3f}, box {:.3f})", state.losses[0], state.losses[1],
                                  state.losses[2]));
      if (state.step % kLogEvery == 0) {
        log.add({{"step", state.step},
                 {"seconds", state.seconds},
                 {"rate", rate},
                 {"loss", state.losses[0]},
                 {"score_loss", state.losses[1]},
                 {"box_loss", state.losses[2]}});
        spdlog::info("step {} rate {:.2e} loss {:.4f} score {:.4f} box {:.4f} {:.0f} s", state.step, rate,
                     state.losses[0], state.losses[1], state.losses[2], state.seconds);
      }
      const bool stop = interrupted();
      const bool check = options.validate_every > 0 && state.step % options.validate_every == 0 &&
                         state.step < options.steps;
      if (const bool due = timer.due(state.step); stop || check || due) checkpoint();
      if (stop) throw Interrupted("interrupted; the checkpoint is kept, the same command goes on from it");
      if (check) validate();
    }
  }
  next.wait();

  TrainingResult result;
  result.steps = state.step;
  result.seconds = state.seconds;
  result.seconds_per_step =
      state.step > first_step ? seconds_since(start) / static_cast<double>(state.step - first_step) : 0;
  result.loss = {state.losses[0], state.losses[1], state.losses[2]};
  result.weights = options.out / (options.detector + ".weights");
  checkpoint();
  detector->save(result.weights, false);
  if (!options.validation.empty()) {
    const DetectionRun run = validate();
    result.validated = true;
    result.at50 = run.at50;
    result.at70 = run.at70;
  }
  return result;
}

}  // namespace mirage
