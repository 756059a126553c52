// mirage rig: finds the rig that recorded a data set: the LiDAR from its sweeps, the camera from its
// calibration.
#include <fmt/format.h>

#include <numbers>
#include <optional>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "scene/unit_finder.h"

namespace mirage::cli {
namespace {

struct RigOptions {
  std::filesystem::path data;
  int sweeps = 6;
};

double degrees(double angle) {
  return angle / kDegree;
}

/// A rig file (scenes/rigs/kitti64.toml says what each key means).
std::string rig_text(const Calibration& calibration, const LidarFit& found, const std::string& data) {
  const PinholeCamera& camera = calibration.camera;
  const LidarModel& lidar = found.lidar;
  std::string text = fmt::format(
      "# Found by mirage rig in {}: {:.2f} % of {} returns lie on a ray. scenes/rigs/kitti64.toml says what "
      "each key\n# means. Not seen in sweeps, and to be put right where they matter: rate, rotation, "
      "divergence.\n\n",
      printable(data), 100 * found.on_rays, found.returns);
  text +=
      fmt::format("[camera]\nwidth = {}\nheight = {}\nfx = {:.6f}\nfy = {:.6f}\ncx = {:.6f}\ncy = {:.6f}\n",
                  camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy);
  text += "camera_from_velo = [\n";
  for (int r = 0; r < 3; ++r) {
    const auto row = calibration.camera_from_velo.matrix().row(r);
    text += fmt::format("  {:.9f}, {:.9f}, {:.9f}, {:.9f},\n", row[0], row[1], row[2], row[3]);
  }
  const Vec3d at = lidar.velo_from_lidar.translation(),
              turned = lidar.velo_from_lidar.linear().eulerAngles(2, 1, 0);  // yaw, pitch, roll
  const auto small = [&](double angle) { return degrees(std::remainder(angle, 2 * std::numbers::pi)); };
  Vec3d yaw_pitch_roll(small(turned[0]), small(turned[1]), small(turned[2]));
  if (std::abs(yaw_pitch_roll[0]) > 90)  // the same turn, with the smallest angles
    for (int i = 0; i < 3; ++i)
      yaw_pitch_roll[i] = std::remainder((i == 1 ? 180 - yaw_pitch_roll[i] : yaw_pitch_roll[i] + 180), 360.0);
  text += fmt::format(
      "]\n\n[lidar]\nname = \"{}\"\nvelo_from_lidar = [{:.4f}, {:.4f}, {:.4f}, {:.4f}, {:.4f}, {:.4f}]\n"
      "height = {:.2f}\nrate = {:g}\nrotation = \"{}\"\nazimuth_step = {:.7f}\nencoder_step = {:.7f}\n"
      "azimuth = [{:.7f}, {:.7f}]\nrange = [{:g}, {:g}]\nbeams = [\n",
      lidar.name, at.x(), at.y(), at.z(), yaw_pitch_roll[2], yaw_pitch_roll[1], yaw_pitch_roll[0],
      lidar.height, lidar.rate, lidar.rotation > 0 ? "counter-clockwise" : "clockwise",
      degrees(lidar.azimuth_step), degrees(lidar.encoder_step), degrees(lidar.azimuth_min),
      degrees(lidar.azimuth_max), lidar.range_min, lidar.range_max);
  for (const LidarBeam& beam : lidar.beams)
    text += fmt::format("  [{:8.4f}, {:7.4f}, {:6.3f}, {:8.4f}],\n", degrees(beam.elevation), beam.height,
                        beam.lateral, degrees(beam.azimuth_offset));
  return text + "]\n";
}

/// The unit that recorded these sweeps: of up to four choices, the first that agrees with 99 % of the
/// returns, else the best.
LidarFit fit_lidar(const DataSet& set, const std::vector<std::string>& ids, std::size_t count,
                   const std::filesystem::path& data) {
  const std::size_t choices = count < ids.size() ? 4 : 1;
  constexpr double kAgreed = 0.99;
  const Transform start = lidar_of(data).velo_from_lidar;
  std::optional<LidarFit> best;
  for (std::size_t choice = 0; choice < choices && !(best && best->on_rays >= kAgreed); ++choice) {
    std::vector<Sweep> sweeps;
    for (std::size_t i = 0; i < count; ++i)
      sweeps.push_back(set.sweep(ids[(choices * i + choice) * ids.size() / (choices * count)]));
    try {
      LidarFit found = find_unit(sweeps, data.string(), start);
      if (!best || found.on_rays > best->on_rays) best = std::move(found);
    } catch (const InputError&) {
      if (choice + 1 == choices && !best) throw;
    }
  }
  return *best;
}

nlohmann::json run(const RigOptions& options, const Common& common) {
  const auto set = open_data_set(options.data);
  const std::vector<std::string> ids = set->frames();
  const std::size_t count = std::min(ids.size(), as_size(options.sweeps));
  const auto [width, height] = set->picture_size(ids.front());
  const Calibration calibration = set->annotations(ids.front(), width, height).calibration;
  const LidarFit found = fit_lidar(*set, ids, count, options.data);
  write_file(common.out, rig_text(calibration, found, options.data.string()));
  const LidarModel lidar = read_lidar_model(common.out);  // as other commands will read it
  print_table(
      {{"sweeps", fmt::format("{} of {}", count, ids.size())},
       {"beams", fmt::format("{}, from {:+.2f} to {:+.2f} degrees", lidar.beams.size(),
                             degrees(lidar.beams.front().elevation), degrees(lidar.beams.back().elevation))},
       {"firings a sweep", fmt::format("{:.0f}", found.firings)},
       {"azimuth step", fmt::format("{:.4f} degrees", degrees(lidar.azimuth_step))},
       {"encoder's grid", lidar.encoder_step > 0 ? fmt::format("{:.4f} degrees", degrees(lidar.encoder_step))
                                                 : std::string("none")},
       {"height over the ground", fmt::format("{:.2f} m", lidar.height)},
       {"returns on a ray", fmt::format("{:.2f} % of {}", 100 * found.on_rays, found.returns)},
       {"rig", common.out.string()}});
  nlohmann::json elevations = nlohmann::json::array();
  for (const LidarBeam& beam : lidar.beams) elevations.push_back(degrees(beam.elevation));
  return {{"rig", common.out.string()},
          {"frames", count},
          {"beams", lidar.beams.size()},
          {"elevations_deg", elevations},
          {"azimuth_step_deg", degrees(lidar.azimuth_step)},
          {"encoder_step_deg", degrees(lidar.encoder_step)},
          {"firings", found.firings},
          {"height_m", lidar.height},
          {"returns", found.returns},
          {"on_rays", found.on_rays}};
}

void add_options(CLI::App& app, RigOptions& options) {
  app.add_option("--data", options.data, "data set (KITTI's object, tracking or raw layout, nuScenes)")
      ->required();
  add_defaulted(app, "--sweeps", options.sweeps, "sweeps to read, evenly spread over the set")
      ->check(within({1, 50}));
}

}  // namespace

Command rig_command() {
  return command_of<RigOptions>({
      .name = "rig",
      .help = "finds the rig that recorded a data set: its LiDAR's beams and firings from sweeps, its camera "
              "from the calibration",
      .default_out = "rig.toml",
      .example = "mirage rig --data path/to/my-log --out my-rig.toml",
      .page = "rig.toml",
      .one_file = "the rig file",
  });
}

}  // namespace mirage::cli
