// mirage validate: re-render in Blender Cycles, compare, write the report.
#include "validation/fidelity/validate.h"

#include <fmt/format.h>

#include <memory>

#include "cli/command.h"
#include "cli/frame_options.h"
#include "cli/picture_rows.h"
#include "cli/trust_option.h"

namespace mirage::cli {
namespace {

void print_fidelity(const nlohmann::json& result) {
  const auto& matched = result.at("matched");
  const auto& attack = result.at("attack");
  const auto number = [](const nlohmann::json& from, const char* key) { return from.at(key).get<double>(); };
  const auto count = [](const nlohmann::json& from, const char* key) { return from.at(key).get<int>(); };
  Rows rows = {
      {"vehicles", fmt::format("{} in {} frames", count(result, "vehicles"), count(result, "frames"))},
      {"roofs", roofs(result.at("rooftops").at("fitted"), result.at("rooftops").at("from_box"))},
      {"matched light",
       fmt::format("mask IoU {:.6f}, MAE {:.2e}, largest error {:.2e}", number(matched, "mask_iou"),
                   number(matched, "mae"), number(matched, "max_error"))},
      {"LiDAR",
       fmt::format("range error {:.2e} m, {} disagreements in {} rays", number(matched, "range_error_m"),
                   count(matched, "hit_disagreements"), count(matched, "rays"))}};
  const auto fidelity = [&](const nlohmann::json& of) {
    return fmt::format("{:.4f} ({} of radiance), SSIM {:.3f}, FLIP {:.3f}, {:.1f} s", number(of, "mae"),
                       percent(number(of, "relative")), number(of, "ssim"), number(of, "flip"),
                       number(of, "seconds"));
  };
  // Without noise, as root mean square: may come out below zero, and then nothing is left that can be seen.
  const auto left = [&](const nlohmann::json& of) {
    if (!of.contains("error_unbiased")) return std::string();
    const auto& interval = of.at("interval");
    return fmt::format("; left to full {:.1f} % ({:.1f} to {:.1f}), noise floor {}",
                       100 * number(interval, "value"), 100 * number(interval, "low"),
                       100 * number(interval, "high"), percent(number(of, "floor")));
  };
  for (const auto& rung : result.at("ladder"))
    rows.push_back({rung.at("effect").get<std::string>(), fidelity(rung) + left(rung)});
  rows.push_back({"full light", fidelity(result.at("full")) + left(result.at("full"))});
  const Reliance reliance = reliance_from_json(result.at("reliance"));
  const bool sees = reliance.uses_picture();  // else who drew the object says nothing about the attack
  for (auto& row : picture_rows(reliance)) rows.push_back(std::move(row));
  if (sees) {
    rows.push_back(
        {"hidden", fmt::format("raster {}, Cycles {}, of {} found clean", count(attack, "hidden_raster"),
                               count(attack, "hidden_cycles"), count(attack, "detected_clean"))});
    rows.push_back({"ASR", fmt::format("raster {}, Cycles {}", percent(number(attack, "asr_raster")),
                                       percent(number(attack, "asr_cycles")))});
  }
  const auto share = [&](const nlohmann::json& of) {
    return percent(number(of, "value"), number(of, "low"), number(of, "high"));
  };
  for (const auto& [group, title] : {std::pair("held_back", "held back"), std::pair("all", "all")})
    for (const auto& variant : result.at("verdict").at(group).at("variants")) {
      const auto name = variant.at("name").get<std::string>();
      if (name == "soft" || (sees && (name == "hard" || name == "cycles")))
        rows.push_back({fmt::format("FN | ASR, {}, {} (95 %)", title, name),
                        fmt::format("{} | {} of {}", share(variant.at("fn_asr")), share(variant.at("asr")),
                                    count(variant, "vehicles"))});
    }
  const auto& verdict = result.at("verdict");
  for (const auto& arm : verdict.at("arms")) {
    const auto light = arm.at("light").get<std::string>();
    if (!sees && light != "raster") continue;
    const auto& gap = arm.at("difference");
    rows.push_back({fmt::format("ASR, {}, {} returns", light, arm.at("returns").get<std::string>()),
                    fmt::format("{} of {}; {:+.1f} points ({:.1f} to {:.1f})", share(arm.at("asr")),
                                count(arm, "vehicles"), 100 * number(gap, "value"), 100 * number(gap, "low"),
                                100 * number(gap, "high"))});
  }
  for (const auto& control : verdict.at("controls"))
    rows.push_back({fmt::format("control: {}, {}", control.at("channel").get<std::string>(),
                                control.at("control").get<std::string>()),
                    fmt::format("{} outcomes of {} change, logits by {:.2f}", count(control, "flips"),
                                count(control, "vehicles"), number(control, "mean_delta_logit"))});
  for (const auto& [channel, what] : {std::pair("image", "drew it"), std::pair("lidar", "met it")})
    if (verdict.at("vacuous").at(channel) == true)
      rows.push_back({fmt::format("vacuous, {}", channel),
                      fmt::format("without the object there nothing changes: who {} says nothing", what)});
  if (sees)
    rows.push_back({"outcome flips", fmt::format("{} vehicles", result.at("verdict").at("flips").size())});
  const bool budgeted = result.contains("budget") && result.at("budget").contains("test");
  if (budgeted && (sees || result.at("budget").at("of") != "score")) {
    const auto& test = result.at("budget").at("test");
    rows.push_back(
        {"budget, left-out scenes",
         fmt::format("{} within {} (asked: {}); time saved {} against always {}", share(test.at("within")),
                     percent(number(result.at("budget"), "budget")),
                     percent(number(result.at("budget"), "confidence")), percent(number(test, "saved")),
                     test.at("fixed").at("chosen").begin().key())});
  }
  if (!result.at("failed").empty())
    rows.push_back({"given up", fmt::format("{} vehicles (Blender was lost)", result.at("failed").size())});
  rows.push_back({"report", result.at("report").get<std::string>()});
  print_table(rows);
}

}  // namespace

Command validate_command() {
  auto options = std::make_shared<ValidationSettings>();
  auto quality = std::make_shared<QualityOption>();
  auto budget_of = std::make_shared<std::string>("radiance");
  return {
      "validate", "re-render in Blender, compare, write the fidelity report", "out/validate",
      [options, budget_of, quality](CLI::App& app) {
        app.add_option("--run", options->run, "folder of a finished mirage attack")->required();
        add_overrides<FrameSource>(app, options->asked);
        app.add_option("--detector", options->detector.detector, "detector (default: the run's)");
        app.add_option("--weights", options->detector.weights, "the detector's weights (default: the run's)");
        app.add_option("--defense", options->detector.defense, "the detector's defence (default: the run's)");
        add_trust_option(app, options->trust);
        app.add_option("--frames", options->frames,
                       fmt::format("frames to validate, test frames first; 0: as many as hold {} vehicles",
                                   kVerdictVehicles))
            ->check(CLI::NonNegativeNumber);
        app.add_option("--samples", options->samples, "Cycles samples a pixel")->check(CLI::Range(1, 65536));
        app.add_option(
               "--ladder", options->ladder,
               "vehicles on which each effect is rendered alone, spread over the frames (default: 4, or all "
               "with --budget)")
            ->check(CLI::NonNegativeNumber);
        app.add_option("--noise", options->noise,
                       "choose the samples of each vehicle for this noise, a share of its mean radiance")
            ->check(CLI::Range(1e-4, 1.0));
        app.add_option("--budget", options->budget,
                       "choose for each scene the cheapest rung whose error stays within this share")
            ->check(CLI::Range(1e-4, 1.0));
        app.add_option("--budget-of", *budget_of, "radiance or score: what the budget is a share of")
            ->capture_default_str();
        quality->add(app, "the run's");
        add_overrides<SimulationSettings>(app, options->asked, {"light"});
        app.add_option("--evaluation", options->evaluation,
                       "result.json (or folder) of mirage evaluate, for the report");
        app.add_option("--tradeoff", options->tradeoff,
                       "result.json (or folder) of mirage tradeoff, for the report");
      },
      [options, budget_of, quality](const Common& common) {
        ValidationSettings settings = *options;
        quality->ask(settings.asked);
        settings.budget_of = parse_budget_of(*budget_of);
        settings.out = common.out;
        settings.seed = common.seed;
        settings.quiet = common.quiet;
        settings.detector.seed = common.seed;
        const nlohmann::json result = validate(settings);
        print_fidelity(result);
        return result;
      }};
}

}  // namespace mirage::cli
