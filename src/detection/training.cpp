#include "detection/training.h"

#include "base/error.h"
#include "base/field_json.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/training_loop.h"
#include "detection/detector_settings.h"
#include "detection/training_data.h"
#include "scene/data/label_census.h"

namespace mirage {
namespace {

/// What must agree for a run to go on.
RunIdentity identity(const TrainingOptions& options, std::size_t frames) {
  nlohmann::json fields = fields_json(options), lacking = lacking_json<TrainingOptions>();
  fields["bfloat16"] = options.precision == kBfloat16;
  fields["frames"] = frames;
  for (const auto& [key, file] : {std::pair("start", options.start), std::pair("camera", options.camera),
                                  std::pair("lidar", options.lidar)}) {
    fields[key] = file.empty() ? "" : file_hash(file);
    lacking[key] = "";
  }
  return {fields, lacking};
}

void check_options(const TrainingOptions& options) {
  check_fields(options);
  if (options.validate_every > 0 && options.validation.empty())
    throw FieldError("validate_every", "", "needs a data set to validate on", "name it with --validation");
  if (options.joint && options.heads)
    throw FieldError("heads", "", "trains less than --joint does", "give one of the two");
  if (options.keep_start > 0 && options.start.empty())
    throw FieldError("keep_start", "", "needs weights to start from", "name them with --start");
}

/// The detector that a new training starts with.
DetectorOptions starting_detector(const TrainingOptions& options) {
  DetectorOptions load{options.detector, options.start, options.start.empty(), options.seed, options.threads};
  load.start = !options.start.empty();
  load.precision = options.precision;
  load.camera = options.camera;
  load.lidar = options.lidar;
  if (options.joint) load.parts = {"joint"};
  if (options.heads) load.parts = {"heads"};
  if (options.keep_start > 0) load.parts.push_back(fmt::format("keep-start={}", options.keep_start));
  return load;
}

/// The same with the weights of a checkpoint.
DetectorOptions resumed_detector(DetectorOptions load, const std::filesystem::path& weights) {
  load.fresh = load.start = false;
  load.camera = load.lidar = "";
  load.weights = weights;
  return load;
}

}  // namespace

TrainingResult train_detector(const TrainingOptions& options) {
  check_options(options);
  make_output_folder(options.out);
  const LabelCensus census = count_labels(options.data, first_frames(options.data, options.frames));
  require_cars(census, "training");
  warn_of_labels(census);
  const DetectorOptions load = starting_detector(options);
  auto detector = load_detector(load);
  TrainingData data(options.data, options.frames, detector->region(), options.seed,
                    options.ground_truth_sampling, detector->capabilities().reads_image, options.thin_lidar,
                    options.rig);
  TrainingLoop loop(options, identity(options, data.size()));
  if (loop.goes_on()) detector = load_detector(resumed_detector(load, loop.state().weights));
  const auto& losses = loop.state().losses;  // total, score, box

  const auto validate = [&] {
    Detector* const judge = detector.get();
    DetectionRun run = detect_data_set({&judge, 1}, options.validation, options.validation_frames);
    loop.log({{"ap50", run.at50.average_precision},
              {"ap70", run.at70.average_precision},
              {"recall50", run.at50.recall}});
    spdlog::info("step {} validation AP 0.5 {:.1f} % AP 0.7 {:.1f} % recall 0.5 {:.1f} %", loop.state().step,
                 100 * run.at50.average_precision, 100 * run.at70.average_precision, 100 * run.at50.recall);
    return run;
  };
  SamplesAhead<std::vector<PreparedSample>> ahead(
      [&](std::int64_t step) { return data.prepare(step, options.batch); });
  TrainingWork work;
  work.learn = [&](std::int64_t step, double rate) {
    const std::vector<PreparedSample> samples = ahead.take(step);
    const TrainingLoss loss = detector->train_step(views_of(samples), rate);
    return std::array{loss.total, loss.score, loss.box};
  };
  work.save = [&](const std::filesystem::path& file) { detector->save(file, true); };
  work.note = [&] {
    return fmt::format("loss {:.3f} (score {:.3f}, box {:.3f})", losses[0], losses[1], losses[2]);
  };
  work.tell = [&](double rate) {
    loop.log({{"rate", rate}, {"loss", losses[0]}, {"score_loss", losses[1]}, {"box_loss", losses[2]}});
    spdlog::info("step {} rate {:.2e} loss {:.4f} score {:.4f} box {:.4f} {:.0f} s", loop.state().step, rate,
                 losses[0], losses[1], losses[2], loop.state().seconds);
  };
  work.validate_every = options.validate_every;
  work.validate = validate;

  TrainingResult result;
  result.seconds_per_step = loop.run(work);
  result.steps = loop.state().step;
  result.seconds = loop.state().seconds;
  result.loss = {losses[0], losses[1], losses[2]};
  result.weights = options.out / (options.detector + ".weights");
  detector->save(result.weights, false);
  if (!options.validation.empty()) {
    if (options.keep_start > 0) detector = load_detector(resumed_detector(load, result.weights));
    const DetectionRun run = validate();
    result.validated = true;
    result.at50 = run.at50;
    result.at70 = run.at70;
  }
  return result;
}

}  // namespace mirage
