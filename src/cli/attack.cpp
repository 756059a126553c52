#include "attack/attack.h"

#include <memory>

#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"

namespace mirage::cli {

Command attack_command() {
  auto settings = std::make_shared<AttackSettings>();
  Command command{
      "attack", "learns the universal adversary; resumes from its checkpoint", "out/attack", {}, {}};
  command.options = [settings](CLI::App& app) {
    app.add_option("--data", settings->data, "data set in KITTI layout")->required();
    add_detector_options(app, settings->detector);
    add_depth_option(app, settings->depth);
    add_rooftop_option(app, settings->rooftop);
    app.add_option("--target", settings->target, "both, image, lidar or random")->capture_default_str();
    app.add_option("--iterations", settings->iterations, "Adam steps")->capture_default_str();
    app.add_option("--batch", settings->batch, "host vehicles a step")->capture_default_str();
    app.add_option("--vertex-rate", settings->vertex_rate, "Adam's rate for vertices, m")
        ->capture_default_str();
    app.add_option("--texel-rate", settings->texel_rate, "Adam's rate for texels")->capture_default_str();
    app.add_option("--min-view", settings->min_view, "share of the adversary in view that a host needs")
        ->capture_default_str();
    app.add_option("--lambda-fp", settings->objective.lambda_fp, "weight of false positives")
        ->capture_default_str();
    app.add_option("--lambda-lap", settings->objective.lambda_laplacian, "weight of smoothness")
        ->capture_default_str();
    app.add_option("--sigma", settings->simulation.raster.sigma, "soft rasteriser's σ")
        ->capture_default_str();
    app.add_option("--supersampling", settings->simulation.supersampling,
                   "camera samples along a pixel's side")
        ->check(CLI::Range(1, 8))
        ->capture_default_str();
    app.add_option("--gamma", settings->simulation.raster.gamma, "soft rasteriser's γ")
        ->capture_default_str();
  };
  command.run = [settings](const Common& common) -> nlohmann::json {
    settings->out = common.out;
    settings->seed = common.seed;
    settings->quiet = common.quiet;
    settings->detector = with_common(settings->detector, common, settings->data);
    const AttackResult result = run_attack(*settings);
    print_table({{"vehicles to train on", std::to_string(result.vehicles_train)},
                 {"vehicles held back", std::to_string(result.vehicles_test)},
                 {"roofs", roofs(result.rooftops.fitted, result.rooftops.from_box)},
                 {"iterations", std::to_string(result.iterations)},
                 {"loss (mean of the last tenth)", fmt::format("{:.4f}", result.loss)},
                 {"seconds an iteration", fmt::format("{:.2f}", result.seconds_per_iteration)},
                 {"adversary", (common.out / "adversary.glb").string()}});
    return {{"vehicles_train", result.vehicles_train},
            {"vehicles_test", result.vehicles_test},
            {"rooftops", to_json(result.rooftops)},
            {"iterations", result.iterations},
            {"loss", result.loss},
            {"seconds_per_iteration", result.seconds_per_iteration}};
  };
  return command;
}

}  // namespace mirage::cli
