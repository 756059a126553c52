// mirage view: frames, boxes and attacks as one page.
#include "validation/view/view.h"

#include <fmt/format.h>

#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/options.h"

namespace mirage::cli {
namespace {

struct ViewOptions {
  ViewSettings settings;
  bool no_detector = false;
};

void add_options(CLI::App& app, ViewOptions& options) {
  ViewSettings& settings = options.settings;
  app.add_option("dir,--data", settings.data, "data set (default with --run or --drive: its own)");
  auto* run_folder =
      app.add_option("--run", settings.run,
                     "run folder of mirage attack: show its vehicles as recorded and attacked. With --drive: "
                     "where its object is now");
  auto* drive =
      app.add_option("--drive", settings.drive,
                     "output folder of mirage drive: play a vehicle's drive as recorded and with the object");
  app.add_option("--vehicle", settings.vehicle,
                 "SEQUENCE_TRACK (default: the vehicle whose gap of detection the object prolongs most)")
      ->needs(drive);
  app.add_option("--animation", settings.animation, "also a moving picture of the vehicle, *.webp or *.gif")
      ->needs(drive);
  app.add_option("--detections", settings.detections,
                 "boxes to draw: detections.json of mirage detect, or a folder of KITTI result files");
  add_defaulted(app, "--frames", settings.frames,
                "show the first N frames (0: all). With --run: N of its frames, test frames first "
                "(0: all test frames)")
      ->check(within(kNotNegative));
  app.add_flag("--no-detector", options.no_detector, "do not run the run's detector");
  app.add_option("--detector", settings.detector.detector, "detector (default: the run's)");
  app.add_option("--weights", settings.detector.weights, "the detector's weights (default: the run's)");
  app.add_option("--defense", settings.detector.defense, "the detector's defence (default: the run's)");
  for (const char* of_run : {"--no-detector", "--detector", "--weights", "--defense"})
    app.get_option(of_run)->needs(run_folder);
  for (const char* who : {"--detector", "--weights", "--defense"})
    app.get_option("--no-detector")->excludes(app.get_option(who));
  add_overrides<FrameSource>(app, settings.overrides, {"depth", "rig", "placement", "cameras"});
  // A drive's page shows what the drive judged, so these options are excluded.
  for (const char* other : {"--frames", "--no-detector", "--detector", "--weights", "--defense", "--depth",
                            "--rig", "--place", "--cameras"})
    drive->excludes(app.get_option(other));
  add_trust_option(app, settings.trust);
  add_defaulted(app, "--size", settings.size, "largest page, MB; beyond it returns are thinned")
      ->check(within({0.1, 2000.0}));
}

nlohmann::json run(const ViewOptions& options, const Common& common) {
  ViewSettings settings = options.settings;
  settings.detect = !options.no_detector;
  settings.page = common.out;
  settings.quiet = common.quiet;
  take_common(settings.detector, common);
  nlohmann::json result = make_view(settings);
  const auto number = [&](const char* key) { return result.at(key).get<double>(); };
  const auto megabytes = [&](const std::string& file, const char* key) {
    return fmt::format("{} ({:.1f} MB)", file, 1e-6 * number(key));
  };
  Rows rows = {{"frames", fmt::format("{:.0f}", number("frames"))}};
  if (result.contains("frames_in_file"))
    rows.emplace_back("of them with detections", fmt::format("{:.0f}", number("frames_in_file")));
  if (result.contains("vehicle"))
    rows.emplace_back("vehicle", result.at("vehicle").get<std::string>() +
                                     (number("learned_on") > 0 ? " (learned on)" : ""));
  else
    rows.emplace_back("attacked vehicles", fmt::format("{:.0f} ({:.0f} of them learned on)",
                                                       number("vehicles"), number("learned_on")));
  rows.emplace_back("returns shown",
                    fmt::format("{:.0f} of {:.0f}", number("kept_points"), number("points")));
  rows.emplace_back("page", megabytes(result.at("page"), "bytes"));
  if (result.contains("animation"))
    rows.emplace_back("animation", megabytes(settings.animation, "animation"));
  print_table(rows);
  return result;
}

}  // namespace

Command view_command() {
  return command_of<ViewOptions>({
      .name = "view",
      .help = "writes a folder of frames as one page that opens offline: pictures, points, boxes, attacks",
      .example = "mirage view --run out/attack",
      .page = "view.html",
  });
}

}  // namespace mirage::cli
