#include "base/intervals.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/options.h"
#include "scene/frame_source.h"

namespace mirage::cli {
namespace {

struct DemoOptions {
  // Enough held-back vehicles (about 100 found clean) that the interval of learned less random excludes zero.
  int frames = 70, iterations = 120, validated = 5;
  FrameSource source;
  QualityOption quality{"default"};
  bool quick = false;
};

/// Sizes of --quick: enough to see every step.
constexpr int kQuickFrames = 6, kQuickIterations = 8, kQuickValidated = 2;

void add_options(CLI::App& app, DemoOptions& options) {
  add_defaulted(app, "--frames", options.frames, "generated frames");
  add_defaulted(app, "--iterations", options.iterations, "attack steps");
  add_fields(app, options.source,
             {"data", "depth", "sun", "rig", "placement", "cameras", "sensors", "classes"});
  options.quality.add(app);
  add_defaulted(app, "--validated", options.validated, "frames rendered in Blender");
  app.add_flag(
      "--quick", options.quick,
      fmt::format("short test of every step, a minute or two each; its rates mean nothing. Sets --frames {} "
                  "--iterations {} --validated {} unless you give them",
                  kQuickFrames, kQuickIterations, kQuickValidated));
  app.callback([&app, &options] {
    if (!options.quick) return;
    if (app.count("--frames") == 0) options.frames = kQuickFrames;
    if (app.count("--iterations") == 0) options.iterations = kQuickIterations;
    if (app.count("--validated") == 0) options.validated = kQuickValidated;
  });
}

nlohmann::json run(const DemoOptions& options, const Common& common) {
  const auto path = [&](const char* name) { return (common.out / name).string(); };
  const std::string data = path("data"), run = path("run"), validated = std::to_string(options.validated);
  const auto step = [&](const char* title, const char* name, NamedSettings settings) {
    std::fputs(fmt::format("\n== {} ==\n", title).c_str(), stdout);
    std::fflush(stdout);
    settings["threads"] = std::to_string(common.threads);
    settings["quiet"] = fmt::format("{}", common.quiet);
    return run_command(name, settings, "mirage demo");
  };
  // Frames of a seed that no shipped detector was trained on.
  step("1/5 generate frames", "generate",
       {{"rig", "kitti64"},
        {"frames", std::to_string(options.frames)},
        {"seed", std::to_string(common.seed + 90001)},
        {"out", data}});
  step("2/5 learn the adversary", "attack",
       {{"data", data},
        {"rooftop", options.source.rooftop},
        {"quality", options.quality.name},
        {"iterations", std::to_string(options.iterations)},
        {"seed", std::to_string(common.seed)},
        {"out", run}});
  const nlohmann::json evaluation =
      step("3/5 evaluate on held-back vehicles", "evaluate",
           {{"run", run}, {"data", data}, {"baseline", "sized"}, {"out", path("evaluate")}});
  step("4/5 export as glTF", "export",
       {{"run", run}, {"data", data}, {"frames", validated}, {"out", path("export")}});
  step("5/5 validate in Blender Cycles", "validate",
       {{"run", run},
        {"data", data},
        {"frames", validated},
        {"evaluation", path("evaluate")},
        {"out", path("validate")}});
  std::fputs("\n", stdout);
  const auto interval = [](const nlohmann::json& json) {
    return Interval{json.at("value"), json.at("low"), json.at("high")};
  };
  const nlohmann::json &learned = evaluation.at("hidden").at("vanished"),
                       &random = evaluation.at("sized").at("hidden").at("vanished"),
                       &difference = evaluation.at("net").at("vanished"),
                       &clusters = evaluation.at("clusters");
  print_table({{"held-back vehicles, found clean", learned.at("vehicles").dump()},
               {"vanish under the learned mesh", percent(interval(learned))},
               {"vanish under a random mesh of its size", percent(interval(random))},
               {"difference, points", signed_points(interval(difference))},
               {"intervals over", to_string(ClusterCount{clusters.at("by"), clusters.at("count")})},
               {"adversary", path("run/adversary.glb")},
               {"report", path("validate/report.html")}});
  return {{"report", path("validate/report.html")},
          {"adversary", path("run/adversary.glb")},
          {"vanished", {{"learned", learned}, {"random", random}, {"difference", difference}}}};
}

}  // namespace

Command demo_command() {
  return command_of<DemoOptions>({
      .name = "demo",
      .help = "runs the whole chain on generated frames: generate → attack → evaluate → export → validate, "
              "which writes the report",
      .example = "mirage demo --quick --out out/demo",
  });
}

}  // namespace mirage::cli
