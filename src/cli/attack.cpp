#include "attack/attack.h"

#include <algorithm>
#include <memory>

#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"
#include "validation/cycles_renderer.h"

namespace mirage::cli {
namespace {

/// What holds of the mesh, in a line.
std::string buildable_words(const nlohmann::json& report) {
  return fmt::format(
      "{} pairs of faces intersect, thinnest wall {:.1f} mm, base {:.0f} cm², {:.0f} % printable",
      report.at("intersecting_pairs").get<int>(), 1e3 * report.at("min_thickness_m").get<double>(),
      1e4 * report.at("base_area_m2").get<double>(), 100 * report.at("texels_in_print_range").get<double>());
}

/// How the attack ended, in a line.
std::string plateau_words(const nlohmann::json& plateau) {
  return fmt::format(
      "{}; the mesh of step {} is kept, the best on {} vehicles held out",
      plateau.at("stopped").get<bool>() ? "reached" : "not reached, more --iterations may help",
      plateau.at("kept_iteration").get<long>(), plateau.at("vehicles").get<int>());
}

}  // namespace

Command attack_command() {
  auto settings = std::make_shared<AttackSettings>();
  auto expect = std::make_shared<std::string>("none");
  auto size = std::make_shared<double>(AdversaryLimits().half.x());
  auto quality = std::make_shared<QualityOption>(QualityOption{"default"});
  auto light = std::make_shared<LightOption>();
  auto effects = std::make_shared<LidarEffectsOption>(LidarEffectsOption{"ideal"});
  auto renderer = std::make_shared<std::string>(kRasterRenderer);
  auto cycles = std::make_shared<CyclesRenderer::Settings>();
  Command command{
      "attack", "learns the universal adversary; resumes from its checkpoint", "out/attack", {}, {}};
  command.options = [settings, quality, light, effects, expect, size, renderer, cycles](CLI::App& app) {
    app.add_option("--data", settings->data, "data set in KITTI layout")->required();
    add_detector_options(app, settings->detector);
    add_depth_option(app, settings->depth);
    add_rooftop_option(app, settings->rooftop);
    app.add_option("--target", settings->target, "both, image, lidar or random")->capture_default_str();
    app.add_option(
           "--parts", settings->parts,
           "what is learned: both, shape, texture, or size (the start's three half lengths alone, a control)")
        ->capture_default_str();
    app.add_option("--size", *size,
                   "L: the mesh stays within ±L along and across the roof and ±5/8 L in height, m")
        ->capture_default_str();
    app.add_option("--expect", *expect,
                   "what is drawn anew for each host and step: none, all, or some of roof,sun,light,exposure,"
                   "noise")
        ->capture_default_str();
    app.add_flag("--buildable", settings->buildable.on,
                 "keep the mesh free of self-intersection, its walls thick, its base flat and its texels "
                 "printable");
    app.add_option("--min-thickness", settings->buildable.min_thickness, "with --buildable: wall, m")
        ->capture_default_str();
    app.add_option("--iterations", settings->iterations, "Adam steps")->capture_default_str();
    app.add_option(
           "--until-plateau", settings->until_plateau,
           "end where the objective on a part of the training vehicles that is held out (a fifth of the "
           "frames, at most 16 vehicles) has not improved for so many steps, and keep the best mesh; 0: "
           "after --iterations, with the last mesh")
        ->capture_default_str();
    app.add_option("--validate-every", settings->validation_every,
                   "with --until-plateau: steps between two looks at that objective")
        ->capture_default_str();
    app.add_option("--batch", settings->batch, "host vehicles a step")->capture_default_str();
    app.add_option("--checkpoint-every", settings->checkpoint_every, "steps between checkpoints")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    add_checkpoint_seconds(app, settings->checkpoint_seconds);
    app.add_option("--vertex-rate", settings->vertex_rate, "Adam's rate for vertices, m")
        ->capture_default_str();
    app.add_option("--texel-rate", settings->texel_rate, "Adam's rate for texels")->capture_default_str();
    app.add_option("--min-view", settings->min_view, "share of the adversary in view that a host needs")
        ->capture_default_str();
    app.add_option("--lambda-fp", settings->objective.lambda_fp, "weight of false positives")
        ->capture_default_str();
    settings->objective.fp_top_k = kFpTopK;
    app.add_option(
           "--fp-top-k", settings->objective.fp_top_k,
           "false positives are sought among so many background proposals, those of the largest logits; 0: "
           "among all of a score over 0.1")
        ->capture_default_str();
    app.add_option("--lambda-lap", settings->objective.lambda_laplacian, "weight of smoothness")
        ->capture_default_str();
    quality->add(app);
    add_camera_options(app, settings->simulation);
    light->add(app, "plain");
    effects->add(app);
    app.add_option(
           "--renderer", *renderer,
           "who draws the object for the detector: raster (--quality, --light), or cycles (Blender; the "
           "gradient goes through raster)")
        ->check(CLI::IsMember({kRasterRenderer, "cycles"}))
        ->capture_default_str();
    app.add_option("--cycles-samples", cycles->samples, "with --renderer cycles: samples a pixel")
        ->check(CLI::Range(1, 4096))
        ->capture_default_str();
    app.add_option(
           "--cycles-renew", settings->renewal.metres,
           "with --renderer cycles: draw anew when the vertices have moved by more than this (root mean "
           "square, m); 0: every step")
        ->capture_default_str();
    app.add_option("--cycles-renew-texels", settings->renewal.texels,
                   "the same for the texels (root mean square of their channels)")
        ->capture_default_str();
    add_sun_option(app, settings->sun);
    tell_of_cache(app);
  };
  command.run = [settings, quality, light, effects, expect, size, renderer,
                 cycles](const Common& common) -> nlohmann::json {
    quality->apply(settings->simulation);
    light->apply(settings->simulation);
    effects->check();
    effects->apply(settings->simulation, lidar_of(settings->data), recorded_lidar_effects(settings->data),
                   common.seed);
    parse_sun(settings->sun);  // complain before a detector is loaded
    settings->out = common.out;
    settings->seed = common.seed;
    settings->quiet = common.quiet;
    settings->detector = with_common(settings->detector, common, settings->data);
    settings->expectation = parse_expectation(*expect);
    settings->limits = limits_of_size(*size);
    if (*renderer != kRasterRenderer && parse_target(settings->target) != AttackTarget::random) {
      cycles->out = common.out;
      cycles->workers = std::min(settings->batch, thread_count());
      settings->renderer = std::make_shared<CyclesRenderer>(*cycles);
    }
    const AttackResult result = run_attack(*settings);
    Rows rows = {{"vehicles to train on", std::to_string(result.vehicles_train)},
                 {"vehicles held back", std::to_string(result.vehicles_test)},
                 {"roofs", roofs(result.rooftops.fitted, result.rooftops.from_box)},
                 {"iterations", std::to_string(result.iterations)},
                 {"loss (mean of the last tenth)", fmt::format("{:.4f}", result.loss)},
                 {"seconds an iteration", fmt::format("{:.2f}", result.seconds_per_iteration)},
                 {"buildable", buildable_words(result.buildable)},
                 {"adversary", (common.out / "adversary.glb").string()}};
    if (!result.plateau.is_null()) rows.insert(rows.begin() + 4, {"plateau", plateau_words(result.plateau)});
    print_table(rows);
    return {{"vehicles_train", result.vehicles_train},
            {"vehicles_test", result.vehicles_test},
            {"rooftops", to_json(result.rooftops)},
            {"iterations", result.iterations},
            {"loss", result.loss},
            {"seconds_per_iteration", result.seconds_per_iteration},
            {"stages", result.stages},
            {"buildable", result.buildable},
            {"plateau", result.plateau}};
  };
  command.many_ranks = true;
  return command;
}

}  // namespace mirage::cli
