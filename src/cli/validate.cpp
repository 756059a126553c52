// mirage validate: re-render in Blender Cycles, compare, write the report.
#include "validation/validate.h"

#include <fmt/format.h>

#include <memory>

#include "cli/command.h"
#include "cli/frame_options.h"
#include "cli/table.h"

namespace mirage::cli {
namespace {

void print_result(const nlohmann::json& result) {
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
  for (const auto& rung : result.at("ladder"))
    rows.push_back({rung.at("effect").get<std::string>(), fidelity(rung)});
  rows.push_back({"full light", fidelity(result.at("full"))});
  rows.push_back(
      {"hidden", fmt::format("raster {}, Cycles {}, of {} found clean", count(attack, "hidden_raster"),
                             count(attack, "hidden_cycles"), count(attack, "detected_clean"))});
  rows.push_back({"ASR", fmt::format("raster {}, Cycles {}", percent(number(attack, "asr_raster")),
                                     percent(number(attack, "asr_cycles")))});
  rows.push_back({"report", result.at("report").get<std::string>()});
  print_table(rows);
}

}  // namespace

Command validate_command() {
  auto options = std::make_shared<ValidationSettings>();
  return {
      "validate", "re-render in Blender, compare, write the fidelity report", "out/validate",
      [options](CLI::App& app) {
        app.add_option("--run", options->run, "folder of a finished mirage attack")->required();
        app.add_option("--data", options->data, "data set (default: the run's)");
        app.add_option("--detector", options->detector.detector, "detector (default: the run's)");
        app.add_option("--weights", options->detector.weights, "the detector's weights (default: the run's)");
        add_rooftop_option_of_run(app, options->rooftop);
        app.add_option("--frames", options->frames,
                       "frames to validate, test frames first; 0: all test frames")
            ->check(CLI::NonNegativeNumber);
        app.add_option("--samples", options->samples, "Cycles samples a pixel")->check(CLI::Range(1, 65536));
        app.add_option("--ladder", options->ladder, "vehicles on which each light effect is rendered alone")
            ->check(CLI::NonNegativeNumber);
        app.add_option("--evaluation", options->evaluation,
                       "result.json (or folder) of mirage evaluate, for the report");
      },
      [options](const Common& common) {
        ValidationSettings settings = *options;
        settings.out = common.out;
        settings.seed = common.seed;
        settings.quiet = common.quiet;
        settings.detector.seed = common.seed;
        const nlohmann::json result = validate(settings);
        print_result(result);
        return result;
      }};
}

}  // namespace mirage::cli
