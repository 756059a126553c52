// mirage generate: writes synthetic frames in KITTI layout.
#include <fmt/format.h>

#include <algorithm>

#include "base/error.h"
#include "base/fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "frames/frame_cache.h"
#include "generator/dataset.h"
#include "generator/generator.h"
#include "scene/data/data_rig.h"

namespace mirage::cli {
namespace {

struct GenerateOptions {
  std::string rig = "kitti64", lidar, look;
  int frames = 10, start = 0, drives = 0;
  double seconds = 5;
  bool depth = false, truth = false;
};

void add_options(CLI::App& app, GenerateOptions& options) {
  const auto listed = [](const char* folder) {
    return fmt::format("{}", fmt::join(shipped_names(folder, ".toml"), ", "));
  };
  add_defaulted(app, "--rig", options.rig, "sensor rig: " + listed("scenes/rigs") + " or a rig file (.toml)");
  app.add_option("--lidar", options.lidar,
                 "LiDAR to use instead of the rig's own: " + listed("scenes/lidars") + " or a file (.toml)");
  app.add_option("--look", options.look, "streets: european or american (default: the rig's own)")
      ->check(one_of({"european", "american"}));
  add_defaulted(app, "--frames", options.frames, "how many frames")->check(within({1, 1000000}));
  add_defaulted(app, "--start", options.start, "index of the first frame, or drive")
      ->check(within({0, 999999}));
  app.add_option("--drives", options.drives,
                 "write N drives instead of single frames: the recording car and the traffic move, 10 frames "
                 "a second, in the layout of KITTI's tracking benchmark")
      ->check(within({1, 10000}));
  add_defaulted(app, "--seconds", options.seconds, "length of each drive, s")->check(within({0.3, 60}));
  app.add_flag("--depth", options.depth,
               "write each frame's true depth too (training/depth/ID.png, KITTI's 16-bit format; sky is 0)");
  app.add_flag("--truth", options.truth,
               "write depth and which object each pixel and point belongs to (training/instance_2/ID.png: k "
               "+ 1 for line k of the labels; training/instance_velodyne/ID.label: SemanticKITTI's layout)");
}

nlohmann::json run(const GenerateOptions& options, const Common& common) {
  Rig rig = read_rig(rig_file(options.rig));
  if (!options.lidar.empty()) rig = with_lidar(rig, options.lidar);
  if (!options.look.empty()) rig = with_look(rig, parse_look(options.look, "generate", "--look"));
  common.provenance->file("rig", rig_file(options.rig));
  common.provenance->input("lidar", lidar_identity(rig.lidar));
  const auto start = Clock::now();
  if (options.drives > 0 && !rig.others.empty())
    throw InputError("--drives", options.rig, "the rig has several cameras, and drives are seen by one",
                     "give a rig of one camera, or single frames");
  if (options.drives > 0 && (options.depth || options.truth))
    throw InputError("--drives", options.truth ? "--truth" : "--depth", "is of single frames",
                     "leave it out: a drive's truth is in training/motion_02");
  const int frames = options.drives > 0 ? options.drives * frames_of_drive(options.seconds) : options.frames;
  Progress progress("generate", as_size(frames), common.quiet);
  const auto on_progress = [&](std::size_t done) { progress.update(done); };
  const auto first = static_cast<std::uint64_t>(options.start);
  const DatasetSummary sum =
      options.drives > 0
          ? generate_drives(rig, common.seed, first, options.drives, options.seconds, common.out, on_progress)
          : generate_dataset(rig, common.seed, first, options.frames, common.out, on_progress,
                             options.truth   ? Truth::all
                             : options.depth ? Truth::depth
                                             : Truth::none);
  const double seconds = seconds_since(start);
  if (!common.quiet) {
    fmt::print("frames written   {:6}   (kept from before: {})\n", sum.written, sum.existing);
    fmt::print("cars labelled    {:6}   (other objects: {})\n", sum.cars, sum.others);
    fmt::print("points a frame   {:6.0f}\n",
               static_cast<double>(sum.points) / std::max(1, sum.written + sum.existing));
    fmt::print("seconds          {:6.1f}   ({})\n", seconds, printable(common.out.string()));
  }
  return nlohmann::json{{"frames", sum.written + sum.existing},
                        {"written", sum.written},
                        {"kept", sum.existing},
                        {"cars", sum.cars},
                        {"others", sum.others},
                        {"points", sum.points},
                        {"rig", rig.name},
                        {"look", name_of(rig.look)},
                        {"seconds", seconds}};
}

}  // namespace

Command generate_command() {
  return command_of<GenerateOptions>({
      .name = "generate",
      .help = "writes generated frames in KITTI's layout",
      .default_out = "generated",
      .example = "mirage generate --rig kitti64 --frames 20 --out generated",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
