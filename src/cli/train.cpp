// mirage train: trains a detector, or learned depth completion, on a data set.
#include <cstdio>

#include "base/error.h"
#include "base/names.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "detection/detector_settings.h"
#include "detection/training.h"
#include "frames/data_check.h"
#include "scene/depth/learned_depth.h"

namespace mirage::cli {
namespace {

struct TrainOptions {
  std::string what = "detector";
  TrainingOptions detector;
  DepthLearning depth;
};

nlohmann::json train_depth_command(const TrainOptions& command, const Common& common) {
  if (!command.detector.validation.empty())
    throw InputError("--validation", "", "is for detectors", "score the result with mirage depth --weights");
  const DepthTrainingOptions options{command.detector, command.depth, command.detector.data,
                                     command.detector.start};
  const DepthTrainingResult result = train_depth(options);
  if (!common.quiet)
    std::printf("steps %lld   %.3f s a step   loss %.4f (depth %.4f, presence %.4f)   weights %s\n",
                static_cast<long long>(result.steps), result.seconds_per_step, result.loss[0], result.loss[1],
                result.loss[2], printable(result.weights.string()).c_str());
  return {{"backend", options.backend},      {"steps", result.steps},
          {"seconds", result.seconds},       {"seconds_per_step", result.seconds_per_step},
          {"loss", result.loss[0]},          {"depth_loss", result.loss[1]},
          {"presence_loss", result.loss[2]}, {"weights", result.weights.string()}};
}

nlohmann::json train_detector_command(const TrainingOptions& options, const Common& common) {
  const TrainingResult result = train_detector(options);
  nlohmann::json json = {{"detector", options.detector}, {"steps", result.steps},
                         {"seconds", result.seconds},    {"seconds_per_step", result.seconds_per_step},
                         {"loss", result.loss.total},    {"weights", result.weights.string()}};
  if (!common.quiet)
    std::printf("steps %lld   %.3f s a step   loss %.4f   weights %s\n", static_cast<long long>(result.steps),
                result.seconds_per_step, result.loss.total, printable(result.weights.string()).c_str());
  if (result.validated) {
    json["validation"] = {{"vehicles", result.at50.boxes},
                          {"ap50", result.at50.average_precision},
                          {"ap70", result.at70.average_precision},
                          {"recall50", result.at50.recall}};
    if (!common.quiet)
      std::printf("%s\n", fmt::format("validation: vehicles {}   AP 0.5 {}   AP 0.7 {}   recall 0.5 {}",
                                      result.at50.boxes, percent(result.at50.average_precision),
                                      percent(result.at70.average_precision), percent(result.at50.recall))
                              .c_str());
  }
  return json;
}

void add_options(CLI::App& app, TrainOptions& options) {
  add_defaulted(app, "what", options.what, "detector, or depth: learned depth completion")
      ->check(one_of({"detector", "depth"}));
  add_fields(app, options.detector);
  app.get_option("--precision")->check(one_of({kFloat, kBfloat16}));
  add_fields(app, options.depth);
}

nlohmann::json run(TrainOptions& options, const Common& common) {
  take_common(options.detector, common);
  for (const auto& data : {options.detector.data, options.detector.validation})
    if (!data.empty()) check_data(data, options.detector.rig, UnitUse::reads_sweeps);
  common.provenance->add(options.detector);
  return options.what == "depth" ? train_depth_command(options, common)
                                 : train_detector_command(options.detector, common);
}

}  // namespace

Command train_command() {
  return command_of<TrainOptions>({
      .name = "train",
      .help = "trains a detector or depth completion; goes on from its checkpoint when the output folder "
              "holds one",
      .example = "mirage train --data generated --detector lidar --steps 2000",
  });
}

}  // namespace mirage::cli
