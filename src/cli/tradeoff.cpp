// mirage tradeoff: the speed–accuracy study.
#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include "cli/command.h"
#include "cli/options.h"
#include "validation/blender/blender_process.h"

namespace mirage::cli {
namespace {

struct TradeoffOptions : TradeoffSettings {};

std::string describe(const TradeoffPoint& point) {
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
    rows.push_back({advice.name + ", shipped", describe(*advice.shipped)});
    if (advice.name != "default")
      rows.push_back({advice.name + ", by these points",
                      advice.point ? describe(*advice.point) : "no point satisfies the rule"});
  }
  for (const TimedAttack& attack : result.attacks)
    rows.push_back({fmt::format("attack, {}", attack.name),
                    fmt::format("{} iterations, ASR {} of {} vehicles", attack.iterations,
                                percent(attack.asr.value), attack.vehicles)});
  rows.push_back(
      {"page", (result.page.empty() ? result.settings.out / "tradeoff.json" : result.page).string()});
  print_table(rows);
}

void add_options(CLI::App& app, TradeoffOptions& options) {
  add_overrides<FrameSource>(app, options.overrides, {}, "the run's, or as mirage attack has it");
  app.add_option("--run", options.run,
                 "finished mirage attack, for its adversary and hosts (default: a random mesh)");
  add_trust_option(app, options.trust);
  add_fields(app, as_base<TradeoffSettings>(options));
  add_fields(app, options.detector);
}

nlohmann::json run(const TradeoffOptions& options, const Common& common) {
  TradeoffSettings settings = options;
  take_common(settings, common);
  take_common(settings.detector, common);
  if (settings.cycles) require_text_path(common.out);
  const TradeoffResult result = tradeoff(settings, [](const auto& out) { return start_blender(out); });
  common.provenance->add(settings);
  print_result(result);
  return to_json(result);
}

}  // namespace

Command tradeoff_command() {
  return command_of<TradeoffOptions>({
      .name = "tradeoff",
      .help = "measures speed against accuracy: fronts and recommended settings",
      .example = "mirage tradeoff --run out/attack",
  });
}

}  // namespace mirage::cli
