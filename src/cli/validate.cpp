// mirage validate: re-render in Blender Cycles, compare, write the report.
#include "validation/fidelity/validate.h"

#include <fmt/format.h>

#include "base/ranks.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/options.h"
#include "validation/blender/blender_process.h"

namespace mirage::cli {
namespace {

struct ValidateOptions {
  ValidationSettings settings;
  QualityOption quality;
};

std::string fidelity(const MeanChange& change, double seconds, const PooledError* error) {
  std::string text = fmt::format("{:.4f} ({} of radiance), SSIM {:.3f}, FLIP {:.3f}, {:.1f} s", change.mae,
                                 percent(change.relative), change.ssim, change.flip, seconds);
  // Without noise, as root mean square: it may be negative, and then no error is visible.
  if (error)
    text += fmt::format("; RMS to full light {:.1f} % ({:.1f} to {:.1f}) without noise, noise floor {}",
                        100 * error->unbiased.value, 100 * error->unbiased.low, 100 * error->unbiased.high,
                        percent(error->floor));
  return text;
}

void add_summary(const ValidationSummary& summary, Rows& rows) {
  const MatchedSummary& matched = summary.matched;
  rows.push_back({"vehicles", fmt::format("{} in {} frames", summary.vehicles, summary.frames)});
  rows.push_back({"roofs", roofs(summary.rooftops.fitted, summary.rooftops.from_box)});
  rows.push_back({"matched light", matched.mask_either == 0
                                       ? "no pixel to compare"
                                       : fmt::format("mask IoU {:.6f}, MAE {:.2e}, largest error {:.2e}",
                                                     matched.mask_iou, matched.mae, matched.max_error)});
  for (const CameraSummary& of : summary.cameras)
    rows.push_back({of.camera, fmt::format("{} vehicles, mask IoU {:.6f}, MAE {:.2e}", of.vehicles,
                                           of.matched.mask_iou, of.matched.mae)});
  rows.push_back({"LiDAR", matched.rays == 0
                               ? "no ray to compare"
                               : fmt::format("range error {:.2e} m, {} disagreements in {} rays",
                                             matched.range_error, matched.hit_disagreements, matched.rays)});
  for (const LightRungSummary& rung : summary.ladder)
    rows.push_back({rung.effect, fidelity(rung.change, rung.seconds, &rung.error)});
  const FullSummary& full = summary.full;
  rows.push_back({"full light", fidelity(full.change, full.seconds, full.error ? &*full.error : nullptr)});
}

void add_attack(const FooledSummary& attack, Rows& rows) {
  rows.push_back({"hidden, ideal returns",
                  fmt::format("raster {}, Cycles {}, of {} held back and found clean", attack.hidden_raster,
                              attack.hidden_cycles, attack.detected_clean)});
  rows.push_back({"ASR (hidden or with a false box), ideal returns",
                  fmt::format("raster {}, Cycles {}", percent(attack.share(attack.fooled_raster)),
                              percent(attack.share(attack.fooled_cycles)))});
}

/// "; -5.9 (-20.0 to +8.2) points: cannot be told", after the rate of an arm that is not the first.
std::string against_first(const Compared<RenderCondition>& condition) {
  if (!condition.difference) return "";
  const Interval& gap = *condition.difference;
  if (condition.flips == 0)
    return fmt::format("; no flips among {} vehicles (at most {:.1f} points)", condition.vehicles,
                       100 * gap.high);
  return fmt::format("; {} points: {}", signed_points(gap), to_word(classify(gap)));
}

/// `sees`: whether the detector uses pictures; otherwise the renderer says nothing about the attack.
void add_verdict(const Verdict& verdict, bool sees, Rows& rows) {
  for (const auto& [group, title] :
       {std::pair(&verdict.held_back, "held back"), std::pair(&verdict.all, "all")}) {
    if (group == &verdict.all && verdict.all.vehicles == verdict.held_back.vehicles) continue;  // none else
    for (const VerdictVariant& variant : group->variants)
      if (variant.kind == VariantKind::soft || (sees && variant.kind != VariantKind::rung))
        rows.push_back(
            {fmt::format("FN | ASR, {}, {} (95 %)", title, variant.name),
             fmt::format("{} | {} of {}", percent(variant.fn_asr), percent(variant.asr), variant.vehicles)});
  }
  for (const auto& condition : verdict.judged().conditions) {
    if (!sees &&
        (condition.key.light == ConditionLight::visible || condition.key.light == ConditionLight::cycles))
      continue;
    rows.push_back(
        {fmt::format("ASR, {}, {} returns", to_word(condition.key.light), to_word(condition.key.returns)),
         fmt::format("{} of {}{}", percent(condition.asr), condition.vehicles, against_first(condition))});
  }
  rows.push_back({"intervals over", to_string(verdict.judged().clusters)});
  for (const auto& control : verdict.controls)
    rows.push_back({fmt::format("control: {}, {}", to_word(control.key.channel), control.key.control),
                    fmt::format("{} of {} outcomes change, logits by {:.2f}", control.flips, control.vehicles,
                                control.mean_delta_logit)});
  for (const auto& [channel, what] :
       {std::pair(Channel::image, "drew it"), std::pair(Channel::lidar, "met it")})
    if (verdict.vacuous(channel) == true)
      rows.push_back({fmt::format("vacuous, {}", to_word(channel)),
                      fmt::format("without the object there nothing changes: who {} says nothing", what)});
  if (sees) rows.push_back({"outcome flips", fmt::format("{} vehicles", verdict.flips.size())});
}

void add_budget(const BudgetReport& budget, Rows& rows) {
  rows.push_back({"budget, left-out scenes",
                  fmt::format("{} within {} (asked: {}); time saved {} against always {}",
                              percent(budget.test->ruled.within), percent(budget.settings.budget),
                              percent(budget.settings.confidence), percent(budget.test->saved),
                              budget.test->fixed.chosen.begin()->first)});
}

void print_fidelity(const Validation& result) {
  Rows rows;
  add_summary(result.summary, rows);
  for (auto& row : picture_rows(result.reliance)) rows.push_back(std::move(row));
  const bool sees = result.reliance.uses_picture();
  if (sees) add_attack(result.summary.attack, rows);
  add_verdict(result.verdict, sees, rows);
  if (result.budget && result.budget->test && (sees || result.budget->settings.of != BudgetOf::score))
    add_budget(*result.budget, rows);
  if (!result.failed.empty())
    rows.push_back({"given up", fmt::format("{} vehicles (Blender was lost)", result.failed.size())});
  if (!result.unseen.empty())
    rows.push_back({"nothing in view",
                    fmt::format("{} vehicles: {}", result.unseen.size(), fmt::join(result.unseen, ", "))});
  rows.push_back({"report", (result.settings.out / "report.html").string()});
  print_table(rows);
}

void add_options(CLI::App& app, ValidateOptions& options) {
  ValidationSettings& settings = options.settings;
  app.add_option("--run", settings.run, "folder of a finished mirage attack")->required();
  add_overrides<FrameSource>(app, settings.overrides);
  add_fields(app, settings.detector, {"precision", "locality", "matching", "clean_memory"}, "the run's");
  add_trust_option(app, settings.trust);
  add_defaulted(
      app, "--expect", settings.expect,
      "vary the object as manufacturing and mounting would, as mirage evaluate --expect does: some of "
      "shape,colour,roof,tilt");
  app.add_option("--frames", settings.frames,
                 fmt::format("frames to validate, test frames first. 0: as many as hold {} vehicles",
                             kVerdictVehicles))
      ->check(within(kNotNegative));
  add_defaulted(app, "--samples", settings.samples, "Cycles samples per pixel")->check(within({1, 65536}));
  app.add_option("--ladder", settings.ladder,
                 "vehicles on which each effect is rendered alone, spread over the frames (default: 4, or "
                 "all with --budget)")
      ->check(within(kNotNegative));
  app.add_option("--noise", settings.noise,
                 "choose samples for each vehicle to reach this noise, a share of its mean radiance "
                 "(default: --samples for all)")
      ->check(within({1e-4, 1.0}));
  app.add_option("--budget", settings.budget,
                 "for each scene choose the cheapest light model and renderer whose error stays within this "
                 "share (default: no choice)")
      ->check(within({1e-4, 1.0}));
  FieldOptions(app, {})({.name = "budget_of", .help = "what the budget is a share of"}, settings.budget_of);
  app.get_option("--budget-of")->needs("--budget");
  add_defaulted(app, "--budget-confidence", settings.budget_confidence,
                "share C of unseen scenes that must stay within the budget; needs C/(1 - C) groups of frames")
      ->check(within({0.5, 0.99}))
      ->needs("--budget");
  options.quality.add(app, "the run's");
  add_overrides<SimulationSettings>(app, settings.overrides, {"light"});
  app.add_option("--evaluation", settings.evaluation,
                 "result.json (or folder) of mirage evaluate, for the report");
  app.add_option("--tradeoff", settings.tradeoff,
                 "result.json (or folder) of mirage tradeoff, for the report");
  app.add_flag("--sign-off", settings.sign_off,
               "writes sign-off.html, too: one A4 page with result, hashes, hidden vehicles by distance and "
               "what was not tested");
}

nlohmann::json run(ValidateOptions& options, const Common& common) {
  ValidationSettings& settings = options.settings;
  options.quality.add_to(settings.overrides);
  take_common(settings, common);
  settings.detector.seed = common.seed;
  settings.provenance = common.provenance;
  const Validation result = validate(settings, [](const auto& out) {
    return start_blender(out, rank() == 0 ? "blender.log" : fmt::format("blender-{}.log", rank()));
  });
  print_fidelity(result);
  nlohmann::json json = to_json(result);
  // The same under the keys by which readers of result.json look for Blender.
  const nlohmann::json& reference = json.at("reference");
  json.update({{"blender", reference.at("version")},
               {"blender_losses", reference.at("losses")},
               {"blender_restarts", reference.at("losses").size()}});
  return json;
}

void afterwards(const ValidateOptions& options, const Common&) {
  write_report(options.settings);
}

}  // namespace

Command validate_command() {
  return command_of<ValidateOptions>({
      .name = "validate",
      .help = "re-renders in Blender, compares, writes the fidelity report",
      .example = "mirage validate --run out/attack --evaluation out/evaluate",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
