// mirage reproduce: the paper's experiments, one command a table.
#include "validation/paper/reproduce.h"

#include "base/error.h"
#include "base/files.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "scene/data/read_frames.h"

namespace mirage::cli {
namespace {

struct ReproduceOptions : paper::ReproduceSettings {};

void print_result(const std::filesystem::path& out, const nlohmann::json& result) {
  for (const auto& table : result.at("tables"))
    if (const auto text = paper::text_file(out, table.at("name")); std::filesystem::exists(text))
      std::fputs(("\n" + read_file(text)).c_str(), stdout);
  Rows rows;
  for (const auto& finding : result.at("findings"))
    rows.push_back({finding.at("claim"), finding.at("verdict")});
  if (result.contains("page")) rows.push_back({"page", result.at("page")});
  print_table(rows);
}

void add_options(CLI::App& app, ReproduceOptions& options) {
  add_defaulted(app, "what", options.what,
                "table1: attack success, KITTI rig; table2: the same, Xenith rig; fig3: recall over IoU; "
                "fig4: success against the size of the mesh; table3: transfer; table4: defences; parts: "
                "shape, texture or size alone; fusions: six detectors, attacked through each sensor, every "
                "mesh judged by all (fusions-xenith: that rig); all");
  app.add_flag("--quick", options.quick, "few frames, iterations and rows: minutes, to see that it runs");
  app.add_option("--kitti64", options.kitti64, "data set of the KITTI rig (default: generated in OUT/data)");
  app.add_option("--xenith", options.xenith, "data set of the Xenith rig (default: generated in OUT/data)");
  app.add_option("--real", options.real, "data set of recorded frames: judge on their vehicles as well");
  add_defaulted(app, "--frames", options.frames, "generated frames of a rig")->check(within(kFromOne));
  add_defaulted(
      app, "--judge-frames", options.judge_frames,
      "judge on all vehicles of N more generated frames per rig. 0: on each attack's held-back vehicles")
      ->check(within(kNotNegative));
  app.add_option("--only", options.only,
                 "some rows of the tables, by the folders of their evaluations: "
                 "kitti64-fusion-both,kitti64-fusion-both-adversarial (default: all)")
      ->delimiter(',');
  add_defaulted(app, "--iterations", options.iterations, "Adam steps of each attack")
      ->check(within(kFromOne));
  add_defaulted(app, "--random-meshes", options.random_meshes, "random meshes of the baseline, pooled")
      ->check(within(kFromOne));
  add_defaulted(app, "--seeds", options.seeds,
                "runs of each attack, with consecutive seeds; intervals then include their spread")
      ->check(within({1, 100}));
  add_defaulted(app, "--pictures", options.pictures, "pictures of each attack")->check(within(kNotNegative));
  app.callback([&app, &options] {
    if (options.quick) paper::make_quick(options, app.count("--frames") == 0, app.count("--iterations") == 0);
  });
}

nlohmann::json run(const ReproduceOptions& options, const Common& common) {
  paper::ReproduceSettings settings = options;
  take_common(settings, common);
  // A step that fails leaves a hole in the tables and the others go on: what no step can read is said now.
  for (const std::filesystem::path& data : {settings.kitti64, settings.xenith, settings.real})
    if (!data.empty()) list_frames(data);
  const nlohmann::json result =
      paper::reproduce(settings, [](const std::string& command, const NamedSettings& named) {
        run_command(command, named, "mirage reproduce");
      });
  if (!result.empty()) print_result(std::filesystem::absolute(settings.out), result);
  return result;
}

/// The tables are written; that they have holes is a failure all the same.
void afterwards(const ReproduceOptions&, const Common& common) {
  const std::filesystem::path file = common.out / "reproduce.json";
  const nlohmann::json steps = read_json(file).at("steps");
  std::size_t failed = 0;
  std::string first;
  for (const auto& [name, step] : steps.items()) {
    if (step.at("status") != "failed") continue;
    ++failed;
    const std::string error = step.at("error");
    if (first.empty() && !error.starts_with("needs ")) first = name + ": " + error;
  }
  if (failed > 0)
    throw Failure(file.string(), fmt::format("{} of {} steps failed; {}", failed, steps.size(), first),
                  "mend it and run the same command: what is done is kept");
}

}  // namespace

Command reproduce_command() {
  return command_of<ReproduceOptions>({
      .name = "reproduce",
      .help = "repeats the experiments of Tu et al. (CoRL 2021): tables with intervals",
      .example = "mirage reproduce table1 --quick",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
