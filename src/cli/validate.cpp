// mirage validate: re-render in Blender Cycles, compare, write the report.
#include "validation/validate.h"

#include <fmt/format.h>

#include <memory>

#include "cli/command.h"

namespace mirage::cli {

Command validate_command() {
  auto options = std::make_shared<ValidationSettings>();
  return {
      "validate", "re-render in Blender, compare, write the fidelity report", "out/validate",
      [options](CLI::App& app) {
        app.add_option("--run", options->run, "folder of a finished mirage attack")->required();
        app.add_option("--data", options->data, "data set (default: the run's)");
        app.add_option("--detector", options->detector.detector, "detector (default: the run's)");
        app.add_option("--weights", options->detector.weights, "the detector's weights (default: shipped)");
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
        const auto& matched = result.at("matched");
        const auto& attack = result.at("attack");
        fmt::print("vehicles             {} in {} frames\n", result.at("vehicles").get<int>(),
                   result.at("frames").get<int>());
        fmt::print("matched light        mask IoU {:.6f}, MAE {:.2e}, largest error {:.2e}\n",
                   matched.at("mask_iou").get<double>(), matched.at("mae").get<double>(),
                   matched.at("max_error").get<double>());
        fmt::print("LiDAR                range error {:.2e} m, {} disagreements in {} rays\n",
                   matched.at("range_error_m").get<double>(), matched.at("hit_disagreements").get<int>(),
                   matched.at("rays").get<int>());
        for (const auto& rung : result.at("ladder"))
          fmt::print("{:<20} MAE {:.4f} ({:.1f} %), SSIM {:.4f}, {:.1f} s\n",
                     rung.at("effect").get<std::string>(), rung.at("mae").get<double>(),
                     100 * rung.at("relative").get<double>(), rung.at("ssim").get<double>(),
                     rung.at("seconds").get<double>());
        fmt::print("hidden, of {} found   raster {}, Cycles {} (ASR {:.3f}, {:.3f})\n",
                   attack.at("detected_clean").get<int>(), attack.at("hidden_raster").get<int>(),
                   attack.at("hidden_cycles").get<int>(), attack.at("asr_raster").get<double>(),
                   attack.at("asr_cycles").get<double>());
        fmt::print("report               {}\n", result.at("report").get<std::string>());
        return result;
      }};
}

}  // namespace mirage::cli
