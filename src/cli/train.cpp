// mirage train: trains a detector on a data set in KITTI layout.
#include <cstdio>
#include <memory>

#include "cli/command.h"
#include "detection/training.h"

namespace mirage::cli {

Command train_command() {
  const auto chosen = std::make_shared<TrainingOptions>();
  Command command;
  command.name = "train";
  command.help = "Trains a detector; goes on from its checkpoint when the output folder holds one";
  command.default_out = "out/train";
  command.options = [chosen](CLI::App& app) {
    app.add_option("--data", chosen->data, "Training set in KITTI layout")->required();
    app.add_option("--detector", chosen->detector, "fusion or lidar")->capture_default_str();
    app.add_option("--validation", chosen->validation, "Data set to score the result on");
    app.add_option("--steps", chosen->steps, "Optimiser steps")->capture_default_str();
    app.add_option("--batch", chosen->batch, "Frames a step")->capture_default_str();
    app.add_option("--learning-rate", chosen->learning_rate, "Peak of the schedule")->capture_default_str();
    app.add_option("--minutes", chosen->minutes, "End the schedule after this time (0: no limit)")
        ->capture_default_str();
    app.add_option("--checkpoint-every", chosen->checkpoint_every, "Steps between checkpoints")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    app.add_option("--frames", chosen->frames, "Only the first N frames (0: all)")->capture_default_str();
    app.add_option("--validation-frames", chosen->validation_frames, "Only the first N (0: all)")
        ->capture_default_str();
  };
  command.run = [chosen](const Common& common) -> nlohmann::json {
    chosen->out = common.out;
    chosen->seed = common.seed;
    chosen->threads = common.threads;
    chosen->quiet = common.quiet;
    const TrainingResult result = train_detector(*chosen);
    nlohmann::json json = {{"detector", chosen->detector}, {"steps", result.steps},
                           {"seconds", result.seconds},    {"seconds_per_step", result.seconds_per_step},
                           {"loss", result.loss.total},    {"weights", result.weights.string()}};
    if (!common.quiet)
      std::printf("steps %lld   %.3f s a step   loss %.4f   weights %s\n",
                  static_cast<long long>(result.steps), result.seconds_per_step, result.loss.total,
                  result.weights.c_str());
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
