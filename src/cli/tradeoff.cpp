// mirage tradeoff: the speed–accuracy study.
#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include <memory>

#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"
#include "cli/trust_option.h"

namespace mirage::cli {
namespace {

std::string in_words(const TradeoffPoint& point) {
  const SimulationSettings& s = point.drawing.value();
  const std::string drawing =
      s.exact_coverage ? "exact areas"
                       : fmt::format("σ {:g}, γ {:g}, cut-off {:g}, {} samples a side", s.raster.sigma,
                                     s.raster.gamma, s.raster.dist_eps, s.supersampling);
  return fmt::format("{}: {:.2f} × default's time, image {:.2f}/255, gradient cosine {:.3f}", drawing,
                     point.ratio, point.image_error(), point.gradient_cosine());
}

void print_result(const TradeoffResult& result) {
  Rows rows = {{"vehicles", fmt::format("{} in {} frames", result.hosts.size(), result.frames)},
               {"points", std::to_string(result.points.size())}};
  for (const Recommendation& advice : result.recommended()) {
    rows.push_back({advice.name + ", shipped", in_words(*advice.shipped)});
    if (advice.name != "default")
      rows.push_back({advice.name + ", by these points",
                      advice.point ? in_words(*advice.point) : "no point satisfies the rule"});
  }
  for (const TimedAttack& attack : result.attacks)
    rows.push_back({fmt::format("attack, {}", attack.name),
                    fmt::format("{} iterations, ASR {} of {} vehicles", attack.iterations,
                                percent(attack.asr.value), attack.vehicles)});
  rows.push_back(
      {"page", (result.page.empty() ? result.settings.out / "tradeoff.json" : result.page).string()});
  print_table(rows);
}

}  // namespace

Command tradeoff_command() {
  auto options = std::make_shared<TradeoffSettings>();
  return {"tradeoff", "the speed–accuracy study: fronts and recommended settings", "out/tradeoff",
          [options](CLI::App& app) {
            add_overrides<FrameSource>(app, options->asked, {}, "the run's, or as mirage attack has it");
            app.add_option("--run", options->run,
                           "finished mirage attack, for its adversary and hosts (default: a random mesh)");
            add_trust_option(app, options->trust);
            app.add_option("--hosts", options->hosts, "vehicles at most, evenly over their distances")
                ->capture_default_str();
            app.add_option("--frames", options->frames, "frames looked at for hosts; 0: all")
                ->capture_default_str();
            app.add_option("--repeats", options->repeats, "repeats of each timing")->capture_default_str();
            app.add_option("--reference-samples", options->reference_samples,
                           "samples along a pixel's side of the reference")
                ->capture_default_str();
            app.add_option("--directions", options->directions,
                           "directions of the finite differences of the hard render")
                ->capture_default_str();
            app.add_option("--depth-frames", options->depth_frames,
                           "frames on which depth completion is scored; 0: none")
                ->check(CLI::NonNegativeNumber)
                ->capture_default_str();
            app.add_option("--detector-hosts", options->detector_hosts,
                           "vehicles on which ways of the detector's passes are timed and compared; 0: none")
                ->capture_default_str();
            app.add_flag("--cycles", options->cycles, "light effects and samples of Blender Cycles as well");
            app.add_option("--cycles-hosts", options->cycles_hosts, "vehicles rendered in Cycles")
                ->capture_default_str();
            app.add_option("--cycles-samples", options->cycles_samples, "samples of Cycles' reference")
                ->capture_default_str();
            app.add_option(
                   "--attack-seconds", options->attack_seconds,
                   "length of an attack at each quality, precision and locality, and its success; 0: none")
                ->capture_default_str();
            add_fields(app, options->detector);
          },
          [options](const Common& common) {
            TradeoffSettings settings = *options;
            settings.out = common.out;
            settings.seed = common.seed;
            settings.quiet = common.quiet;
            settings.detector.seed = common.seed;
            settings.detector.threads = common.threads;
            const TradeoffResult result = tradeoff(settings);
            print_result(result);
            return to_json(result);
          }};
}

}  // namespace mirage::cli
