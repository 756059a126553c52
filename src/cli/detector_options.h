// Options that every command with a detector shares.
#pragma once

#include <CLI/CLI.hpp>

#include "cli/command.h"
#include "detection/detector.h"
#include "detection/precision.h"
#include "scene/data_rig.h"

namespace mirage::cli {

inline void add_detector_options(CLI::App& app, DetectorOptions& options) {
  app.add_option("--detector", options.detector,
                 "lidar, camera, painted, fusion, late, torchscript or a plugin (*.so)")
      ->capture_default_str();
  app.add_option("--weights", options.weights,
                 "weights file (default: the shipped ones for the data set's rig), or real: the shipped ones "
                 "fine-tuned on KITTI, for non-commercial use");
  app.add_option("--defense", options.defense,
                 "what the detector is defended by: none, jpeg:QUALITY, or shipped weights of mirage defend "
                 "(adversarial, denoising, depth-gate, adversarial-depth-gate)")
      ->capture_default_str();
  app.add_option(
         "--clean-memory", options.clean_memory_mb,
         "MB of what the detector makes of frames without the object that are kept, so that only what "
         "the object changes is computed anew; 0: every pass is over the whole frame")
      ->check(CLI::Range(0, 1 << 20))
      ->capture_default_str();
  app.add_option(
         "--precision", options.precision,
         "of the detector's convolutions: float, bfloat16 (float where the processor lacks it), or double, "
         "a slow reference")
      ->check(CLI::IsMember({kFloat, kBfloat16, kDouble}))
      ->capture_default_str();
  app.add_option(
         "--locality", options.locality,
         "m: what the detector makes of places further from the object's changes is left as it was, which is "
         "quicker and an approximation; 0: nothing is left out")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
}

/// `data`: the data set that the detector is to see; its rig chooses the shipped weights.
inline DetectorOptions with_common(DetectorOptions options, const Common& common,
                                   const std::filesystem::path& data) {
  options.rig = data_rig(data);
  options.seed = common.seed;
  options.threads = common.threads;
  return options;
}

}  // namespace mirage::cli
