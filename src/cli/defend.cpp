// mirage defend: fine-tunes a detector to resist.

#include "cli/command.h"
#include "cli/options.h"
#include "defense/adversarial_training.h"
#include "detection/detector_settings.h"
#include "frames/frame_provenance.h"

namespace mirage::cli {
namespace {

struct DefendOptions {
  DefenseSettings settings;
  std::string method = "adversarial";
  const CLI::App* app = nullptr;  ///< knows which options were given
};

nlohmann::json run(const DefendOptions& options, const Common& common) {
  DefenseSettings settings = options.settings;
  set_method(options.method, settings);
  for (const std::string& field : unused_fields(options.method))
    if (options.app->get_option(option_of(*options.app, field))->count() > 0)
      throw FieldError(field, "", "decides nothing with the method " + options.method,
                       "leave it out, or use another --method");
  take_common(settings, common);
  settings.detector = with_common(settings.detector, common, settings);
  const DefenseResult result = train_defended(settings);
  common.provenance->add(settings);
  add_detector(*common.provenance, settings.detector);
  Rows rows = {{"hosts", std::to_string(result.hosts)},
               {"updates", std::to_string(result.steps)},
               {"seconds an update", fmt::format("{:.2f}", result.seconds_per_step)},
               {"loss (running mean)", fmt::format("{:.3f}", result.loss.total)},
               {"weights", result.weights.string()}};
  nlohmann::json json = {{"method", options.method},
                         {"hosts", result.hosts},
                         {"steps", result.steps},
                         {"seconds_per_step", result.seconds_per_step},
                         {"loss", result.loss.total},
                         {"adversary_loss", result.adversary_loss},
                         {"weights", result.weights.string()}};
  if (result.validated) {
    const auto both = [](const PrecisionRecall& before, const PrecisionRecall& after) {
      return fmt::format("{:.1f} → {:.1f} %", 100 * before.average_precision, 100 * after.average_precision);
    };
    rows.push_back({"clean AP 0.5, before → after", both(result.at50_before, result.at50)});
    rows.push_back({"clean AP 0.7, before → after", both(result.at70_before, result.at70)});
    json["ap50_before"] = result.at50_before.average_precision;
    json["ap70_before"] = result.at70_before.average_precision;
    json["ap50"] = result.at50.average_precision;
    json["ap70"] = result.at70.average_precision;
  }
  print_table(rows);
  return json;
}

void add_options(CLI::App& app, DefendOptions& options) {
  options.app = &app;
  add_fields(app, options.settings, {"minutes"});  // a run is of so many steps
  app.get_option("--precision")->check(one_of({kFloat, kBfloat16}));
  add_defaulted(app, "--method", options.method,
                "adversarial (free adversarial training); denoising (the same with non-local means on image "
                "features); depth-gate (fusion weighs image features by agreement in depth, trained clean); "
                "ceiling (random meshes, under a ceiling of 1.4 m); controls: roof-objects (random meshes in "
                "the adversary's place), picture-dropout (half of the samples without their picture)");
}

}  // namespace

Command defend_command() {
  return command_of<DefendOptions>({
      .name = "defend",
      .help = "fine-tunes a detector to resist: adversarial training, feature denoising, depth gate; and "
              "controls",
      .example = "mirage defend --data generated --method adversarial --steps 1000",
  });
}

}  // namespace mirage::cli
