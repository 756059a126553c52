// Settings of an attack. Each setting is defined once, in its struct's visit_fields (base/fields.h): option,
// key of run.json, range, and whether it decides the result.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "attack/adversary.h"
#include "attack/buildable.h"
#include "attack/eot.h"
#include "attack/objective.h"
#include "base/fields.h"
#include "base/schedule.h"
#include "detection/detector.h"
#include "scene/frame_source.h"
#include "simulation/insertion.h"

namespace mirage {

/// The sensor whose gradient reaches the adversary. Both sensors always see it (modality gating). random: no
/// gradient; the adversary is the random mesh.
enum class AttackTarget { both, image, lidar, random };
constexpr auto words_of(AttackTarget) {
  return std::to_array<const char*>({"both", "image", "lidar", "random"});
}

/// The learned part of the adversary; the rest keeps its start value. size: the half lengths of the start's
/// ellipsoid alone, as a control (adversary.h, half_length_gradient).
enum class AttackParts { both, shape, texture, size };
constexpr auto words_of(AttackParts) {
  return std::to_array<const char*>({"both", "shape", "texture", "size"});
}

/// plain: one start, one rate, Adam. automatic ("auto"): many of them, judged on vehicles held out from
/// training (attack/portfolio.h). black_box ("black-box"): scores alone, no gradient (attack/black_box.h).
enum class AttackSearch { plain, automatic, black_box };
constexpr auto words_of(AttackSearch) {
  return std::to_array<const char*>({"plain", "auto", "black-box"});
}

/// Host vehicles in unlabelled frames. labels: no hosts there. detections: the vehicles that the detector
/// finds without the object (attack/attack_hosts.h).
enum class HostSource { labels, detections };
constexpr auto words_of(HostSource) {
  return std::to_array<const char*>({"labels", "detections"});
}

class ObjectRenderer;

/// Name of the simulation's own rasteriser in run.json.
inline constexpr const char* kRasterRenderer = "raster";

/// How far a mesh may move before an ObjectRenderer draws it anew (attack/observation.h).
struct RedrawThresholds {
  double metres = 0.01;  ///< of its vertices, root mean square
  double texels = 0.05;  ///< of its texels' channels, root mean square
};

/// Upper limit of iterations, beyond any machine: for attacks limited by time, and for values in files.
inline constexpr int kMaxIterations = 1'000'000'000;

/// All settings of an attack: data, detector, target, learned parts, rates and limits.
struct AttackSettings : FrameSource {
  std::filesystem::path out;
  DetectorOptions detector;
  std::string weights_hash;  ///< content_hash of the weights; run_attack(settings) fills it in
  AttackSearch attack = AttackSearch::plain;
  AttackTarget target = AttackTarget::both;
  AttackParts parts = AttackParts::both;
  EotSettings expectation;
  BuildableSettings buildable;
  int iterations = 200;
  int queries = 2000;  ///< a black-box attack's limit of detector passes with the object
  /// > 0: the attack ends when the objective on held-out validation vehicles (attack_hosts.h) has not
  /// improved for this many steps, or after `iterations`. It keeps the mesh of the best check. 0: trains on
  /// all training vehicles, and keeps the last mesh.
  int until_plateau = 0;
  int validation_every = 20;  ///< steps between two checks of that objective
  /// > 0: limit of the iterations' time in seconds, which makes the result depend on the machine.
  double seconds = 0;
  int batch = 8;  ///< hosts per iteration; their losses are averaged
  std::uint64_t seed = 0;
  /// Adam's rates. Tu et al. train for thousands of steps at 1e-3 and 4e-3. These rates need only hundreds of
  /// steps, but require the batch (src/README.md, Adversary).
  double vertex_rate = 2e-2, texel_rate = 2e-2;
  double min_view = 0.7;
  HostSource hosts_from = HostSource::labels;
  CheckpointInterval checkpoint{10};
  bool quiet = false;
  AdversaryLimits limits;
  ObjectiveSettings objective;
  SimulationSettings simulation;
  /// Draws the object for the detector; null: the simulation's own rasteriser.
  std::shared_ptr<ObjectRenderer> renderer;
  RedrawThresholds redraw;  ///< limits for redrawing
};

/// Sets the limits to the placement's volume unless they were set.
void fit_limits(AttackSettings& settings);

template <class Visitor, FieldsOf<AttackSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, as_base<FrameSource>(s));
  visit_fields(visit, s.detector);
  visit({.name = "weights_hash", .option = ""}, s.weights_hash);
  visit({.name = "attack",
         .help = "plain: one start and rate; auto: searches shapes, starts, targets and rates "
                 "within --iterations, and chooses on vehicles held out from training; black-box: by an "
                 "evolution strategy on the detector's scores alone, within --queries",
         .lacking = "plain"},
        s.attack);
  visit({.name = "target",
         .help = "sensor whose gradient trains the object: both, image or lidar; random: no training, a "
                 "random mesh"},
        s.target);
  visit({.name = "parts",
         .help = "what to learn: both (shape and texture), shape, texture, or size (the start's three half "
                 "lengths alone, as a control)"},
        s.parts);
  visit.list({.name = "limits",
              .help = "L: the mesh stays within ±L along and across and ±5/8 L in height, m",
              .option = "size"},
             s.limits);
  visit.list({.name = "expectation",
              .help = "what to vary at random for each host and step: none, all, or some of "
                      "roof,tilt,shape,colour,sun,light,exposure,noise. shape:0.02 moves vertices by 2 cm "
                      "(rms); paints:24 prints in 24 colours; worst:4 learns on the worst of 4 draws",
              .option = "expect",
              .lacking = ""},
             s.expectation);
  visit({.name = "gamut",
         .help = "colours of the print, without --free: fogra39 (offset, coated paper), a CMYK printer's ICC "
                 "profile, a chart of patches (CGATS text) or box:BLACK,WHITE",
         .lacking = ""},
        s.buildable.gamut);
  visit.list({.name = "buildable", .lacking = ""}, s.buildable);
  visit({.name = "iterations", .help = "Adam steps", .range = {0, kMaxIterations}, .decides = false},
        s.iterations);
  visit({.name = "queries",
         .help = "with --attack black-box: passes of the detector with the object, over at most 24 of the "
                 "training vehicles",
         .range = {1, kMaxIterations},
         .decides = false},
        s.queries);
  visit({.name = "until_plateau",
         .help = "stop when the validation objective has not improved for N steps, and keep the best "
                 "mesh. Validation takes a fifth of the training frames at most, until they show 16 "
                 "vehicles. 0: stop after --iterations with the last mesh",
         .range = kNotNegative,
         .decides = false},  // but for the vehicles held out, which run.json names
        s.until_plateau);
  visit({.name = "validation_every",
         .help = "with --until-plateau or --attack auto: steps between two validations",
         .range = kFromOne,
         .option = "validate-every",
         .lacking = "20"},
        s.validation_every);
  visit({.name = "batch", .help = "host vehicles per step", .range = {1, 65536}}, s.batch);
  visit({.name = "seed", .option = ""}, s.seed);  // every command has one
  visit_fields(visit, s.checkpoint);
  visit({.name = "vertex_rate", .help = "Adam's rate for vertices, m", .range = kPositive}, s.vertex_rate);
  visit({.name = "texel_rate", .help = "Adam's rate for texels", .range = kPositive}, s.texel_rate);
  visit({.name = "min_view",
         .help = "a vehicle is a host if at least this share of the object is in view",
         .range = kShare},
        s.min_view);
  visit({.name = "hosts_from",
         .help = "hosts in frames without labels: labels (none), or detections (the detector's "
                 "boxes without the object become labels, in OUT/labelled)",
         .lacking = "labels"},
        s.hosts_from);
  visit_fields(visit, s.objective);
  visit.group({.name = "simulation"}, s.simulation);
}

}  // namespace mirage
