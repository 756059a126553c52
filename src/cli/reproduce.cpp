// mirage reproduce: the paper's experiments, one command a table.
#include "validation/paper/reproduce.h"

#include <fmt/format.h>

#include <memory>

#include "cli/command.h"
#include "cli/field_options.h"
#include "cli/named_settings.h"
#include "cli/table.h"

namespace mirage::cli {
namespace {

void print_result(const paper::ReproduceResult& result) {
  for (const paper::TableResult& table : result.tables)
    std::fputs(fmt::format("\n{}", paper::markdown(table)).c_str(), stdout);
  Rows rows;
  for (const paper::Finding& finding : result.findings) rows.push_back({finding.claim, overall(finding)});
  if (!result.page.empty()) rows.push_back({"page", result.page.string()});
  print_table(rows);
}

void add_options(CLI::App& app, paper::ReproduceSettings& options) {
  app.add_option(
         "what", options.what,
         "table1: attack success, KITTI rig; table2: the same, Xenith rig; fig3: recall over IoU; fig4: "
         "success against the size of the mesh; table3: transfer; table4: defences; parts: shape, texture or "
         "size alone; fusions: six detectors, "
         "attacked through each sensor, every mesh judged by all (fusions-xenith: that rig); all")
      ->capture_default_str();
  app.add_flag("--quick", options.quick,
               "few frames and iterations, some rows of many: all of it in minutes, to see that it runs");
  app.add_option("--kitti64", options.kitti64, "data set of the KITTI rig (default: generated in OUT/data)");
  app.add_option("--xenith", options.xenith, "data set of the Xenith rig (default: generated in OUT/data)");
  app.add_option("--real", options.real, "real frames: the same on their vehicles");
  app.add_option("--frames", options.frames, "generated frames of a rig")
      ->check(within(kFromOne))
      ->capture_default_str();
  app.add_option("--judge-frames", options.judge_frames,
                 "generated frames of a rig beside those, on all of whose vehicles attacks are judged; 0: on "
                 "vehicles that each attack has held back")
      ->check(within(kNotNegative))
      ->capture_default_str();
  app.add_option("--only", options.only,
                 "some rows of the tables, by the names of their evaluations: "
                 "kitti64-fusion-both,kitti64-fusion-both-adversarial (default: all)")
      ->delimiter(',');
  app.add_option("--iterations", options.iterations, "Adam steps of each attack")
      ->check(within(kFromOne))
      ->capture_default_str();
  app.add_option("--random-meshes", options.random_meshes, "random meshes of the baseline, pooled")
      ->check(within(kFromOne))
      ->capture_default_str();
  app.add_option("--seeds", options.seeds,
                 "runs of each attack, from seeds one apart; intervals then know their spread")
      ->check(within({1, 100}))
      ->capture_default_str();
  app.add_option("--pictures", options.pictures, "pictures of each attack that shows some")
      ->check(within(kNotNegative))
      ->capture_default_str();
}

}  // namespace

Command reproduce_command() {
  auto options = std::make_shared<paper::ReproduceSettings>();
  return Command{
      .name = "reproduce",
      .help = "repeats the experiments of Tu et al. (CoRL 2021): tables with intervals",
      .default_out = "out/reproduce",
      .example = "mirage reproduce table1 --quick",
      .options = [options](CLI::App& app) { add_options(app, *options); },
      .run =
          [options](const Common& common) {
            paper::ReproduceSettings settings = *options;
            settings.out = common.out;
            settings.seed = common.seed;
            settings.threads = common.threads;
            settings.quiet = common.quiet;
            if (settings.quick) paper::make_quick(settings);
            const paper::ReproduceResult result =
                paper::reproduce(settings, [](const std::string& command, const NamedSettings& named) {
                  run_command(command, named, "mirage reproduce");
                });
            print_result(result);
            return to_json(result);
          },
      .many_ranks = true,
  };
}

}  // namespace mirage::cli
