#include "attack/attack.h"

#include <algorithm>
#include <memory>

#include "base/files.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"
#include "validation/blender/blender_process.h"

namespace mirage::cli {
namespace {

struct AttackOptions {
  AttackSettings settings;
  QualityOption quality{"default"};
  LidarEffectsOption effects{"ideal"};
  std::string renderer = kRasterRenderer;
  CyclesRenderer::Settings cycles;
};

/// Draws the object for the detector; null: the insertion's rasteriser does.
std::shared_ptr<CyclesRenderer> make_renderer(const AttackOptions& options, const AttackSettings& settings) {
  if (options.renderer == kRasterRenderer || settings.target == AttackTarget::random) return nullptr;
  CyclesRenderer::Settings cycles = options.cycles;
  cycles.out = settings.out;
  cycles.workers = std::min(settings.batch, thread_count());
  return std::make_shared<CyclesRenderer>(cycles);
}

/// Sets the rasteriser of the gradient: the user's options, else, beside Cycles' pictures, the settings
/// closest to them. With the default settings the mesh descends half as far (src/guide/evidence.md, Light).
void apply_rasteriser(const AttackOptions& options, SimulationSettings& settings) {
  QualityOption quality = options.quality;
  if (options.renderer != kRasterRenderer) {
    const auto is_set = [&](const char* option) { return quality.is_set(option); };
    if (!is_set("--quality") && std::ranges::none_of(kSoftOptions, is_set)) quality.name = "exact";
    if (!quality.is_set("--light")) settings.light = LightModel::visible;
  }
  quality.apply(settings);
}

/// The measures of the mesh in one line.
std::string buildable_words(const BuildableReport& report) {
  return fmt::format(
      "{} pairs of faces intersect, thinnest wall {:.1f} mm, base {:.0f} cm², {:.0f} % printable",
      report.intersecting_pairs, 1e3 * report.min_thickness, 1e4 * report.base_area, 100 * report.printable);
}

/// The message for a run that has already finished its iterations.
std::string already_done(int iterations, const AttackSettings& settings) {
  if (settings.attack == AttackSearch::black_box)
    return fmt::format("already done: {} meshes; more --queries go on", iterations);
  const bool more = settings.until_plateau == 0 && settings.attack == AttackSearch::plain;
  return fmt::format("already done: {0} of {0} iterations{1}", iterations,
                     more ? fmt::format("; --iterations above {} goes on", iterations) : "");
}

/// How the attack ended, in a line.
std::string plateau_words(const PlateauReport& plateau) {
  return fmt::format("{}; the mesh of step {} is kept, the best on {} vehicles held out",
                     plateau.stopped ? "reached" : "not reached, more --iterations may help",
                     plateau.kept_iteration, plateau.vehicles);
}

/// The choice of --attack auto in one line.
std::string auto_words(const AutoReport& report) {
  const AutoReport::Candidate& candidate = report.candidates.at(report.chosen);
  return fmt::format("of {} the one from {}, target {}, after {} steps: {:.4f} on {} vehicles held out",
                     report.candidates.size(), candidate.start, to_word(candidate.target),
                     candidate.kept_iteration, candidate.held_out, report.vehicles);
}

/// A summary of --attack black-box in one line.
std::string black_box_words(const BlackBoxReport& report) {
  return fmt::format("{} over {} vehicles: {} generations of {} meshes by {} numbers, from {}: {:.4f}",
                     report.queries, report.vehicles, report.generations, report.samples, report.numbers,
                     report.start, report.loss);
}

void add_options(CLI::App& app, AttackOptions& options) {
  add_fields(app, options.settings);
  options.quality.add(app);
  options.effects.add(app);
  add_defaulted(
      app, "--renderer", options.renderer,
      "what draws the object: raster (see --quality, --light), or cycles (Blender Cycles; the gradient still "
      "comes from raster, then by default with --quality exact --light visible)")
      ->check(one_of({kRasterRenderer, "cycles"}));
  add_defaulted(app, "--cycles-samples", options.cycles.samples, "with --renderer cycles: samples per pixel")
      ->check(within({1, 4096}));
  add_defaulted(app, "--cycles-renew", options.settings.redraw.metres,
                "with --renderer cycles: render again when vertices have moved by this (root mean square, "
                "m). 0: every step");
  add_defaulted(app, "--cycles-renew-texels", options.settings.redraw.texels,
                "with --renderer cycles: render again when texels have changed by this (root mean square)");
  add_cache_note(app);
}

nlohmann::json run(const AttackOptions& options, const Common& common) {
  AttackSettings settings = options.settings;
  apply_rasteriser(options, settings.simulation);
  options.effects.check();
  options.effects.apply(settings.simulation, lidar_of(settings.data, settings.rig),
                        recorded_lidar_effects(settings.data, settings.rig), common.seed);
  settings.simulation.camera_effects.seed = common.seed;
  take_common(settings, common);
  settings.detector = with_common(settings.detector, common, settings);
  fit_limits(settings);
  const std::shared_ptr<CyclesRenderer> cycles = make_renderer(options, settings);
  settings.renderer = cycles;
  const AttackResult result = run_attack(settings);
  if (rank() == 0) {
    common.provenance->add(settings);
    // A longer run's object stays if fewer queries or iterations are asked for: record those that were made.
    if (const auto& search = result.black_box; search && search->queries > settings.queries)
      common.provenance->set("queries", search->queries);
    else if (!search && result.iterations > settings.iterations)
      common.provenance->set("iterations", result.iterations);
    if (settings.buildable.on)
      common.provenance->input("gamut", content_hash(to_json(settings.buildable.gamut).dump()));
    if (settings.renderer) common.provenance->set("renderer", settings.renderer->identity());
    add_frames(*common.provenance, settings, list_frames(settings.data));
    add_detector(*common.provenance, settings.detector);
  }
  // A finished run takes no further steps; a random mesh has no iterations.
  const bool done = result.steps == 0 && result.iterations > 0;
  Rows rows = {{"training vehicles", std::to_string(result.vehicles_train)},
               {"detector, as recorded", describe(result.found_clean)},
               {"test vehicles", std::to_string(result.vehicles_test)},
               {"evaluation's intervals are over", to_string(result.clusters)},
               {"roofs", roofs(result.rooftops.fitted, result.rooftops.from_box)},
               {result.black_box ? "meshes tried" : "iterations",
                done ? already_done(result.iterations, settings) : std::to_string(result.iterations)},
               {"loss (mean of the last tenth)", fmt::format("{:.4f}", result.loss)},
               {result.buildable.holds(settings.buildable.min_thickness) ? "buildable" : "not buildable",
                buildable_words(result.buildable)},
               {"adversary", (common.out / "adversary.glb").string()}};
  if (!done)
    rows.insert(rows.begin() + 6,
                {"seconds an iteration", fmt::format("{:.2f}", result.seconds_per_iteration)});
  if (result.plateau) rows.insert(rows.begin() + 5, {"plateau", plateau_words(*result.plateau)});
  if (result.automatic) rows.insert(rows.begin() + 5, {"candidates", auto_words(*result.automatic)});
  if (result.black_box) rows.insert(rows.begin() + 5, {"queries", black_box_words(*result.black_box)});
  nlohmann::json json = to_json(result);
  if (cycles) {
    json["pictures"] = {{"reference", cycles->drawn()}};
    rows.push_back({"pictures drawn", fmt::format("{} by Cycles", cycles->drawn())});
  }
  print_table(rows);
  return json;
}

}  // namespace

Command attack_command() {
  return command_of<AttackOptions>({
      .name = "attack",
      .help = "learns the universal adversary; resumes from its checkpoint",
      .example = "mirage attack --data path/to/kitti --detector fusion --iterations 200 --out out/attack",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
