// Adversarial training: fine-tuning a detector on frames with an adversary that keeps learning meanwhile.
//
// In the style of free adversarial training (Shafahi et al., NeurIPS 2019), as Tu et al. (CoRL 2021) use it:
// one adversary persists through the whole training. Before each model step it takes a few Adam steps against
// the current model (attack/attack_step.h: any vehicle, both sensors). Training starts from clean weights.
// Part of every batch stays clean, so that the detector does not forget clean frames.
//
// Two controls separate the effect of the adversary from side effects: samples with random meshes (the
// detector has merely seen objects on roofs), and samples without the picture (it has learned to do without).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "attack/adversary.h"
#include "detection/average_precision.h"
#include "detection/training.h"
#include "scene/frame_source.h"

namespace mirage {

/// The mesh on the roofs of attacked samples. adversary: the mesh that keeps learning. random: each sample
/// has its own random mesh (random_load), and only the model learns.
enum class Carried { adversary, random };
constexpr auto words_of(Carried) {
  return std::to_array<const char*>({"adversary", "random"});
}

/// The paper's random mesh (random_adversary), stretched along each axis to between half of the box and the
/// whole box, in 1 to 40 patches of random colours. Depends on (seed, index) alone.
TexturedMesh random_load(std::uint64_t seed, std::uint64_t index, const AdversaryLimits& limits);

/// Settings of adversarial training: its start, its length and the strength of its adversary.
struct DefenseSettings : FrameSource, TrainingSchedule {
  DefenseSettings() {
    steps = 400;
    learning_rate = 5e-4;
    checkpoint.steps = 50;
  }
  std::filesystem::path validation;  ///< may be empty
  /// The start of training (empty weights: the shipped clean ones), and parts added to the network.
  DetectorOptions detector;
  Carried carried = Carried::adversary;
  double attacked = 0.5;  ///< share of a batch that carries a mesh (rounded)
  double left_out = 0;    ///< share of the samples without their picture (drawn)
  int adversary_updates =
      5;                    ///< a step of the model; 0: none, and without random meshes every sample is clean
  int adversary_batch = 2;  ///< hosts an update
  double vertex_rate = 5e-3, texel_rate = 2e-2;  ///< of the adversary
  std::size_t validation_frames = 0;             ///< only the first N (0: all)
};

/// In the identity the weights count by content (train_defended), not by path.
template <class Visitor, FieldsOf<DefenseSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<FrameSource>(s));
  visit({.name = "validation", .help = "data set to score it on, clean, before and after", .decides = false},
        s.validation);
  visit({.name = "detector", .help = "fusion or lidar"}, s.detector.detector);
  visit({.name = "weights",
         .help = "where training starts",
         .otherwise = "the shipped clean ones for the data set's rig",
         .decides = false},
        s.detector.weights);
  visit({.name = "precision",
         .help = "precision of convolutions, in training and in the adversary's gradient: float or "
                 "bfloat16 (float where the processor lacks it)",
         .lacking = kFloat,
         .check = check_precision},
        s.detector.precision);
  visit({.name = "defense", .option = "", .lacking = "none"}, s.detector.defense);
  visit_fields(visit, as_base<TrainingSchedule>(s));
  visit({.name = "carried", .option = "", .lacking = "adversary"}, s.carried);
  visit({.name = "attacked", .help = "share of a batch that carries a mesh", .range = kShare}, s.attacked);
  visit({.name = "left_out", .range = kShare, .option = "", .lacking = "0"}, s.left_out);
  visit({.name = "adversary_updates",
         .help = "updates of the adversary before each of the model",
         .range = kNotNegative},
        s.adversary_updates);
  visit({.name = "adversary_batch", .help = "host vehicles such an update", .range = kFromOne},
        s.adversary_batch);
  visit({.name = "vertex_rate", .help = "the adversary's rate for vertices, m", .range = kPositive},
        s.vertex_rate);
  visit({.name = "texel_rate", .help = "the adversary's rate for texels", .range = kPositive}, s.texel_rate);
  visit({.name = "validation_frames", .help = "only the first N (0: all)", .decides = false},
        s.validation_frames);
}

/// Result of adversarial training; at50 and at70 are on clean frames.
struct DefenseResult : TrainingResult {
  int hosts = 0;
  double adversary_loss = 0;  ///< last step's (objective.h; negative: mostly false positives)
  PrecisionRecall at50_before, at70_before;
};

/// The words of `mirage defend --method`, also used to name its weights.
const std::vector<std::string>& defense_methods();
/// Sets the settings that define the method: parts, carried mesh, omitted pictures. FieldError naming method
/// for an unknown word.
void set_method(const std::string& method, DefenseSettings& settings);
/// Names of the settings without effect under the method: those of an adversary that does not learn, and the
/// attacked share if nothing is carried. Errors as set_method.
std::vector<std::string> unused_fields(const std::string& method);

/// Trains, or resumes from the newest checkpoint in `out` to the same result (InputError for other settings
/// or frames). FieldError for settings out of range, a share that rounds to none or all of a batch, a
/// detector of boxes in the picture, and unsupported parts. InputError for data without hosts. Writes
/// out/training.jsonl (a line every 10 steps: step, seconds, rate, loss, score_loss, box_loss, hide,
/// false_positive) and the last adversary, out/adversary.glb.
DefenseResult train_defended(const DefenseSettings& settings);

}  // namespace mirage
