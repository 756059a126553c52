// mirage train: trains a detector, or learned depth completion, on a data set.
#include <cstdio>
#include <memory>

#include "base/error.h"
#include "base/names.h"
#include "cli/command.h"
#include "detection/precision.h"
#include "detection/training.h"
#include "scene/depth/depth_training.h"

namespace mirage::cli {
namespace {

struct TrainOptions : TrainingOptions {
  std::string what = "detector", backend = "guided";
  int crop = DepthTrainingOptions().crop;
  DepthAugmentation augmentation;
};

nlohmann::json train_depth_command(const TrainOptions& given, const Common& common) {
  if (!given.validation.empty())
    throw InputError("--validation", "", "is for detectors", "score the result with mirage depth --weights");
  DepthTrainingOptions options;
  options.data = given.data;
  options.out = common.out;
  options.backend = given.backend;
  options.steps = given.steps;
  options.batch = given.batch;
  options.crop = given.crop;
  options.start = given.start;
  options.augmentation = given.augmentation;
  options.learning_rate = given.learning_rate;
  options.minutes = given.minutes;
  options.checkpoint_every = given.checkpoint_every;
  options.checkpoint_seconds = given.checkpoint_seconds;
  options.frames = given.frames;
  options.seed = common.seed;
  options.threads = common.threads;
  options.quiet = common.quiet;
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

}  // namespace

Command train_command() {
  const auto options = std::make_shared<TrainOptions>();
  Command command;
  command.name = "train";
  command.help =
      "Trains a detector or depth completion; goes on from its checkpoint when the output folder holds one";
  command.default_out = "out/train";
  command.options = [options](CLI::App& app) {
    app.add_option("what", options->what, "detector, or depth: learned depth completion")
        ->check(CLI::IsMember({"detector", "depth"}))
        ->capture_default_str();
    app.add_option("--data", options->data, "Training set (KITTI's object, tracking or raw layout, nuScenes)")
        ->required();
    app.add_option("--detector", options->detector, "lidar, camera, painted, fusion or late")
        ->capture_default_str();
    app.add_option("--depth", options->backend, "depth: guided, or a plugin's path (*.so)")
        ->capture_default_str();
    app.add_option("--crop", options->crop, "depth: width of a sample, pixels")->capture_default_str();
    app.add_option("--start", options->start,
                   "Weights to start from (default: fresh ones); fusion may start from lidar weights");
    app.add_option("--camera", options->camera,
                   "detector: weights of a camera detector that the new one starts from");
    app.add_option("--lidar", options->lidar,
                   "detector: weights of a lidar detector that the new one starts from");
    app.add_flag(
        "--joint", options->joint,
        "detector: what --camera, --lidar and COCO's weights gave learns too; else it stays as it is");
    app.add_flag(
        "--heads", options->heads,
        "detector camera: the layers that find boxes learn, in place of the mask's (frames that do not "
        "say which pixels show vehicles teach the mask nothing)");
    app.add_option("--precision", options->precision,
                   "detector: of convolutions, float or bfloat16 (float where the processor lacks it)")
        ->check(CLI::IsMember({kFloat, kBfloat16}))
        ->capture_default_str();
    app.add_option("--without-picture", options->augmentation.without_picture,
                   "depth: share of samples whose picture is one grey")
        ->capture_default_str();
    app.add_option("--scatter", options->augmentation.scatter,
                   "depth: largest share of a sample's returns that stray from their place")
        ->capture_default_str();
    app.add_option("--shift", options->augmentation.shift,
                   "depth: pixels by which returns may be off the picture together")
        ->capture_default_str();
    app.add_option("--validation", options->validation, "Data set to score the result on");
    app.add_option("--steps", options->steps, "Optimiser steps")->capture_default_str();
    app.add_option("--batch", options->batch, "Frames a step")->capture_default_str();
    app.add_option("--learning-rate", options->learning_rate, "Peak of the schedule")->capture_default_str();
    app.add_option("--minutes", options->minutes, "End the schedule after this time (0: no limit)")
        ->capture_default_str();
    app.add_option("--checkpoint-every", options->checkpoint_every, "Steps between checkpoints")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    add_checkpoint_seconds(app, options->checkpoint_seconds);
    app.add_option("--frames", options->frames, "Only the first N frames (0: all)")->capture_default_str();
    app.add_option("--ground-truth-sampling", options->ground_truth_sampling,
                   "detector: mean number of other frames' vehicles pasted into a sample; fusion needs a set "
                   "made with --truth")
        ->capture_default_str();
    app.add_option("--thin-lidar", options->thin_lidar,
                   "detector: share of the samples that lose beams, or returns of some cars")
        ->capture_default_str();
    app.add_option("--validate-every", options->validate_every,
                   "detector: steps between validations (0: at the end only)")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
    app.add_option("--validation-frames", options->validation_frames, "Only the first N (0: all)")
        ->capture_default_str();
  };
  command.run = [options](const Common& common) -> nlohmann::json {
    if (options->what == "depth") return train_depth_command(*options, common);
    options->out = common.out;
    options->seed = common.seed;
    options->threads = common.threads;
    options->quiet = common.quiet;
    const TrainingResult result = train_detector(*options);
    nlohmann::json json = {{"detector", options->detector}, {"steps", result.steps},
                           {"seconds", result.seconds},     {"seconds_per_step", result.seconds_per_step},
                           {"loss", result.loss.total},     {"weights", result.weights.string()}};
    if (!common.quiet)
      std::printf("steps %lld   %.3f s a step   loss %.4f   weights %s\n",
                  static_cast<long long>(result.steps), result.seconds_per_step, result.loss.total,
                  printable(result.weights.string()).c_str());
    if (result.validated) {
      json["validation"] = {{"vehicles", result.at50.boxes},
                            {"ap50", result.at50.average_precision},
                            {"ap70", result.at70.average_precision},
                            {"recall50", result.at50.recall}};
      if (!common.quiet)
        std::printf("validation: vehicles %d   AP50 %.3f   AP70 %.3f   recall50 %.3f\n", result.at50.boxes,
                    result.at50.average_precision, result.at70.average_precision, result.at50.recall);
    }
    return json;
  };
  return command;
}

}  // namespace mirage::cli
