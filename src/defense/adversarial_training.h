// Making a detector robust: fine-tuning it on frames that carry an adversary, which goes on learning
// meanwhile.
//
// In the style of free adversarial training (Shafahi et al., NeurIPS 2019), as Tu et al. (CoRL 2021) use it:
// one adversary persists through the whole training and takes a few Adam steps against the model of the
// moment (attack/attack_step.h: any vehicle, both sensors) before each step of the model. Training starts
// from clean weights. Part of every batch stays clean, so that the detector does not forget the world as it
// is.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>

#include "base/interrupt.h"
#include "detection/average_precision.h"
#include "detection/training.h"
#include "scene/frame_source.h"

namespace mirage {

/// What adversarial training starts from, how long it goes on, and how strong its adversary is.
struct DefenseSettings : FrameSource {
  std::filesystem::path validation, out;  ///< `validation` may be empty
  /// Where training starts (empty weights: the shipped clean ones) and what is added to the network (parts).
  DetectorOptions detector;
  std::int64_t steps = 400;
  int batch = 2;
  double attacked = 0.5;      ///< share of a batch that carries the adversary (rounded)
  int adversary_updates = 5;  ///< a step of the model; 0: none, and every sample is clean
  int adversary_batch = 2;    ///< hosts an update
  double learning_rate = 5e-4;
  double vertex_rate = 5e-3, texel_rate = 2e-2;   ///< of the adversary
  std::size_t frames = 0, validation_frames = 0;  ///< only the first N (0: all)
  std::int64_t checkpoint_every = 50;
  double checkpoint_seconds = 0;  ///< > 0: also where so many seconds have passed since the last one
  std::uint64_t seed = 0;
  int threads = 0;
  bool quiet = false;
  /// Asked after every step; true ends the run with a checkpoint, and throws Interrupted.
  std::function<bool()> stop = interrupted;
};

/// What adversarial training ends with, beside the weights in DefenseSettings::out.
struct DefenseResult {
  std::int64_t steps = 0;
  int hosts = 0;
  double seconds_per_step = 0;
  TrainingLoss loss;              ///< running mean at the end
  double adversary_loss = 0;      ///< of its last step (objective.h; negative: false positives prevail)
  std::filesystem::path weights;  ///< out/DETECTOR.weights
  bool validated = false;
  PrecisionRecall at50_before, at70_before, at50, at70;  ///< clean, on `validation`
};

/// Trains, or goes on from the newest checkpoint in `out` (of the same settings, or InputError), to the same
/// result. InputError for settings out of range and for data without a host. Writes out/training.jsonl (a
/// line every 10 steps: step, seconds, rate, loss, score_loss, box_loss, hide, false_positive) and the last
/// adversary, out/adversary.glb.
DefenseResult train_defended(const DefenseSettings& settings);

}  // namespace mirage
