// mirage defend: fine-tunes a detector to resist.
#include <memory>

#include "base/error.h"
#include "cli/command.h"
#include "cli/detector_options.h"
#include "cli/frame_options.h"
#include "cli/table.h"
#include "defense/adversarial_training.h"

namespace mirage::cli {
namespace {

struct DefendOptions {
  DefenseSettings settings;
  std::string method = "adversarial";
};

/// The words of --method and of the shipped weights.
void apply_method(const std::string& method, DefenseSettings& settings) {
  if (method == "denoising") {
    settings.detector.parts = {"denoising"};
  } else if (method == "depth-gate" || method == "adversarial-depth-gate") {
    settings.detector.parts = {"depth-gate"};
    if (method == "depth-gate") settings.adversary_updates = 0;
  } else if (method != "adversarial") {
    throw InputError(
        "--method", method, "unknown defence",
        "use adversarial, denoising, depth-gate or adversarial-depth-gate (JPEG needs no training: "
        "--defense jpeg:QUALITY)");
  }
}

}  // namespace

Command defend_command() {
  auto options = std::make_shared<DefendOptions>();
  Command command{"defend",
                  "fine-tunes a detector to resist: adversarial training, feature denoising, depth gate",
                  "out/defend",
                  {},
                  {}};
  command.options = [options](CLI::App& app) {
    DefenseSettings& settings = options->settings;
    add_fields(app, static_cast<FrameSource&>(settings));
    app.add_option("--validation", settings.validation, "data set that scores it, clean, before and after");
    app.add_option("--detector", settings.detector.detector, "fusion or lidar")->capture_default_str();
    app.add_option("--weights", settings.detector.weights,
                   "where training starts (default: the shipped clean ones for the data set's rig)");
    app.add_option("--method", options->method,
                   "adversarial (free adversarial training); denoising (the same with non-local means in the "
                   "image branch); depth-gate (fusion weighs image features by agreement in depth, trained "
                   "clean); adversarial-depth-gate (both)")
        ->capture_default_str();
    app.add_option("--steps", settings.steps, "updates of the model")->capture_default_str();
    app.add_option("--batch", settings.batch, "samples an update")->capture_default_str();
    app.add_option("--attacked", settings.attacked, "share of a batch that carries the adversary")
        ->capture_default_str();
    app.add_option("--adversary-updates", settings.adversary_updates,
                   "updates of the adversary before each of the model")
        ->capture_default_str();
    app.add_option("--adversary-batch", settings.adversary_batch, "host vehicles such an update")
        ->capture_default_str();
    app.add_option("--learning-rate", settings.learning_rate, "peak of the one-cycle schedule")
        ->capture_default_str();
    app.add_option("--vertex-rate", settings.vertex_rate, "the adversary's rate for vertices, m")
        ->capture_default_str();
    app.add_option("--texel-rate", settings.texel_rate, "the adversary's rate for texels")
        ->capture_default_str();
    app.add_option("--frames", settings.frames, "only the first N frames (0: all)")->capture_default_str();
    app.add_option("--validation-frames", settings.validation_frames, "only the first N (0: all)")
        ->capture_default_str();
    app.add_option("--checkpoint-every", settings.checkpoint_every,
                   "updates of the model between checkpoints")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    add_checkpoint_seconds(app, settings.checkpoint_seconds);
  };
  command.run = [options](const Common& common) -> nlohmann::json {
    DefenseSettings settings = options->settings;
    apply_method(options->method, settings);
    settings.out = common.out;
    settings.seed = common.seed;
    settings.threads = common.threads;
    settings.quiet = common.quiet;
    settings.detector = with_common(settings.detector, common, settings.data);
    const DefenseResult result = train_defended(settings);
    std::vector<std::pair<std::string, std::string>> rows = {
        {"hosts", std::to_string(result.hosts)},
        {"updates", std::to_string(result.steps)},
        {"seconds an update", fmt::format("{:.2f}", result.seconds_per_step)},
        {"loss (running mean)", fmt::format("{:.3f}", result.loss.total)},
        {"weights", result.weights.string()}};
    nlohmann::json json = {{"method", options->method},
                           {"hosts", result.hosts},
                           {"steps", result.steps},
                           {"seconds_per_step", result.seconds_per_step},
                           {"loss", result.loss.total},
                           {"adversary_loss", result.adversary_loss},
                           {"weights", result.weights.string()}};
    if (result.validated) {
      const auto both = [](const PrecisionRecall& before, const PrecisionRecall& after) {
        return fmt::format("{:.1f} → {:.1f}", 100 * before.average_precision, 100 * after.average_precision);
      };
      rows.push_back({"clean AP50, before → after", both(result.at50_before, result.at50)});
      rows.push_back({"clean AP70, before → after", both(result.at70_before, result.at70)});
      json["ap50_before"] = result.at50_before.average_precision;
      json["ap70_before"] = result.at70_before.average_precision;
      json["ap50"] = result.at50.average_precision;
      json["ap70"] = result.at70.average_precision;
    }
    print_table(rows);
    return json;
  };
  return command;
}

}  // namespace mirage::cli
