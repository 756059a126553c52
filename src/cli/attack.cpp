#include "attack/attack.h"

#include <algorithm>
#include <memory>

#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"
#include "validation/blender/cycles_renderer.h"

namespace mirage::cli {
namespace {

struct AttackOptions {
  AttackSettings settings;
  QualityOption quality{"default"};
  LidarEffectsOption effects{"ideal"};
  std::string renderer = kRasterRenderer;
  CyclesRenderer::Settings cycles;
};

/// What holds of the mesh, in a line.
std::string buildable_words(const BuildableReport& report) {
  return fmt::format(
      "{} pairs of faces intersect, thinnest wall {:.1f} mm, base {:.0f} cm², {:.0f} % printable",
      report.intersecting_pairs, 1e3 * report.min_thickness, 1e4 * report.base_area, 100 * report.printable);
}

/// How the attack ended, in a line.
std::string plateau_words(const PlateauReport& plateau) {
  return fmt::format("{}; the mesh of step {} is kept, the best on {} vehicles held out",
                     plateau.stopped ? "reached" : "not reached, more --iterations may help",
                     plateau.kept_iteration, plateau.vehicles);
}

/// What --attack auto chose, in a line.
std::string auto_words(const AutoReport& report) {
  const AutoReport::Candidate& candidate = report.candidates.at(report.chosen);
  return fmt::format("of {} the one from {}, target {}, after {} steps: {:.4f} on {} vehicles held out",
                     report.candidates.size(), candidate.start, to_word(candidate.target),
                     candidate.kept_iteration, candidate.held_out, report.vehicles);
}

void add_options(CLI::App& app, AttackOptions& options) {
  options.settings.objective.fp_top_k = kFpTopK;
  add_fields(app, options.settings);
  options.quality.add(app);
  options.effects.add(app);
  app.add_option("--renderer", options.renderer,
                 "who draws the object for the detector: raster (--quality, --light), or cycles (Blender; "
                 "the gradient goes through raster)")
      ->check(CLI::IsMember({kRasterRenderer, "cycles"}))
      ->capture_default_str();
  app.add_option("--cycles-samples", options.cycles.samples, "with --renderer cycles: samples a pixel")
      ->check(CLI::Range(1, 4096))
      ->capture_default_str();
  app.add_option("--cycles-renew", options.settings.renewal.metres,
                 "with --renderer cycles: draw anew when the vertices have moved by more than this (root "
                 "mean square, m); 0: every step")
      ->capture_default_str();
  app.add_option("--cycles-renew-texels", options.settings.renewal.texels,
                 "the same for the texels (root mean square of their channels)")
      ->capture_default_str();
  tell_of_cache(app);
}

nlohmann::json run(const AttackOptions& options, const Common& common) {
  AttackSettings settings = options.settings;
  options.quality.apply(settings.simulation);
  options.effects.check();
  options.effects.apply(settings.simulation, lidar_of(settings.data), recorded_lidar_effects(settings.data),
                        common.seed);
  settings.out = common.out;
  settings.seed = common.seed;
  settings.quiet = common.quiet;
  settings.detector = with_common(settings.detector, common, settings.data);
  if (options.renderer != kRasterRenderer && settings.target != AttackTarget::random) {
    CyclesRenderer::Settings cycles = options.cycles;
    cycles.out = common.out;
    cycles.workers = std::min(settings.batch, thread_count());
    settings.renderer = std::make_shared<CyclesRenderer>(cycles);
  }
  const AttackResult result = run_attack(settings);
  Rows rows = {{"vehicles to train on", std::to_string(result.vehicles_train)},
               {"vehicles held back", std::to_string(result.vehicles_test)},
               {"roofs", roofs(result.rooftops.fitted, result.rooftops.from_box)},
               {"iterations", std::to_string(result.iterations)},
               {"loss (mean of the last tenth)", fmt::format("{:.4f}", result.loss)},
               {"seconds an iteration", fmt::format("{:.2f}", result.seconds_per_iteration)},
               {"buildable", buildable_words(result.buildable)},
               {"adversary", (common.out / "adversary.glb").string()}};
  if (result.plateau) rows.insert(rows.begin() + 4, {"plateau", plateau_words(*result.plateau)});
  if (result.automatic) rows.insert(rows.begin() + 4, {"candidates", auto_words(*result.automatic)});
  print_table(rows);
  return to_json(result);
}

}  // namespace

Command attack_command() {
  auto options = std::make_shared<AttackOptions>();
  return Command{
      .name = "attack",
      .help = "learns the universal adversary; resumes from its checkpoint",
      .default_out = "out/attack",
      .options = [options](CLI::App& app) { add_options(app, *options); },
      .run = [options](const Common& common) { return run(*options, common); },
      .many_ranks = true,
  };
}

}  // namespace mirage::cli
