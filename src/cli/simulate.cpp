#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>

#include "base/files.h"
#include "base/image.h"
#include "base/names.h"
#include "base/schedule.h"
#include "cli/command.h"
#include "cli/options.h"
#include "exchange/mesh_files.h"
#include "frames/data_check.h"
#include "frames/frame_provenance.h"
#include "frames/hosts.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "scene/recorded_light.h"
#include "scene/shape/shape_fit.h"
#include "sensors/ray_caster.h"
#include "simulation/render_scene.h"
#include "simulation/sensor_pass.h"

namespace mirage::cli {
namespace {

struct SimulateOptions {
  std::filesystem::path mesh;
  std::string frame;
  int vehicle = 0;
  InsertionOptions insertion;
  SimulateOptions() { insertion.cameras = Cameras::all; }
};

/// A full-size grey picture of how far the object covers each pixel: level 255 times the share. write_srgb
/// encodes what it is given, so it is given the linear value of that level.
ImageF mask_picture(const CameraSight& simulated) {
  ImageF mask(simulated.image.width, simulated.image.height, 1);
  for (int v = simulated.rect.v0; v < simulated.rect.v1; ++v)
    for (int u = simulated.rect.u0; u < simulated.rect.u1; ++u)
      mask.at(u, v) = linear_from_srgb(static_cast<float>(rgba_at(simulated, u, v, 3)));
  return mask;
}

/// The camera's depth (m) with the object: at pixels that it covers by more than half, where the ray through
/// their centre meets it.
ImageF depth_picture(const PreparedFrame& prepared, const Simulated& simulated, const RayCaster& object,
                     std::size_t camera) {
  ImageF depth = prepared.depth_of(camera);
  const CameraSight& sight = simulated.sight(camera);
  const Calibration& calibration = prepared.frame.calibration_of(camera);
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const Vec3d origin = velo_from_camera.translation();
  for (int v = sight.rect.v0; v < sight.rect.v1; ++v)
    for (int u = sight.rect.u0; u < sight.rect.u1; ++u) {
      if (!(rgba_at(sight, u, v, 3) > 0.5)) continue;
      const Vec3d towards = (velo_from_camera.linear() * calibration.camera.unproject(u, v, 1)).normalized();
      const Hit hit = object.intersect({origin.cast<float>(), towards.cast<float>()});
      if (hit.hit())
        depth.at(u, v) = static_cast<float>((calibration.camera_from_velo * (origin + hit.t * towards)).z());
    }
  return depth;
}

/// Removes files of an earlier simulation in this folder that this one may lack, by the names of cameras and
/// sensors in its result.
void remove_earlier_pictures(const std::filesystem::path& folder) {
  const nlohmann::json before = earlier_result(folder);
  for (const std::string& name : listed_names(before, "cameras"))
    for (const std::string& picture :
         {"image-" + name + ".png", "mask-" + name + ".png", "depth-" + name + ".exr"})
      std::filesystem::remove(folder / picture);
  for (const std::string& name : listed_names(before, "sensors"))
    std::filesystem::remove(folder / (escape_name(name) + ".f32"));
}

/// Picture, mask and depth of each camera that sees the object; the first's in any case.
void write_sights(const PreparedFrame& prepared, const Simulated& simulated,
                  const std::filesystem::path& folder) {
  const Mesh object = placed_adversary(simulated).mesh;
  const RayCaster caster({&object, 1});
  for (std::size_t k = 0; k < prepared.frame.cameras(); ++k) {
    const CameraSight& sight = simulated.sight(k);
    if (sight.image.empty()) continue;
    const std::string suffix = k == 0 ? "" : "-" + prepared.frame.name_of(k);
    write_srgb(folder / ("image" + suffix + ".png"), sight.image);
    write_srgb(folder / ("mask" + suffix + ".png"), mask_picture(sight));
    write_exr(folder / ("depth" + suffix + ".exr"), depth_picture(prepared, simulated, caster, k));
  }
}

/// Each camera's view of the object, by name.
nlohmann::json cameras_json(const Frame& frame, const Simulated& simulated) {
  nlohmann::json cameras;
  for (std::size_t k = 0; k < frame.cameras(); ++k) {
    const CameraSight& sight = simulated.sight(k);
    const PixelRect& rect = sight.rect;
    cameras[frame.name_of(k)] = {{"adversary_pixels", sight.adversary_pixels},
                                 {"visible_share", sight.visible_share},
                                 {"rect", {rect.u0, rect.v0, rect.u1, rect.v1}}};
  }
  return cameras;
}

/// "31", or for several cameras "CAM_BACK 31, CAM_BACK_LEFT 5".
std::string pixel_counts(const Frame& frame, const Simulated& simulated) {
  if (frame.others.empty()) return std::to_string(simulated.adversary_pixels);
  std::string counts;
  for (std::size_t k = 0; k < frame.cameras(); ++k)
    if (const int pixels = simulated.sight(k).adversary_pixels; pixels > 0)
      counts += fmt::format("{}{} {}", counts.empty() ? "" : ", ", frame.name_of(k), pixels);
  return counts.empty() ? "0" : counts;
}

nlohmann::json run(const SimulateOptions& options, const Common& common) {
  InsertionOptions settings = options.insertion;
  settings.apply();
  const SunChoice sun = parse_sun(settings.sun);
  const TexturedMesh adversary = read_object(options.mesh);
  const LidarModel lidar = lidar_of(settings.data, settings.rig);
  check_data(settings.data, settings.rig, UnitUse::casts_rays);
  const auto depth = load_depth_completion({settings.depth});
  const auto finder = make_roof_finder(settings.rooftop, lidar);
  Frame frame = read_frame(settings.data, options.frame, settings.cameras);
  frame.lighting = with_sun(frame, sun);
  mark_sought(classes_of(settings.classes), frame.labels);
  auto measured_by = record(load_sensors(settings.sensors), settings.data, frame);
  PreparedFrame prepared = prepare(std::move(frame), lidar, depth.get());
  prepared.measured_by = std::move(measured_by);
  const Label& host = vehicle_of(prepared.frame, options.vehicle, "--vehicle");
  const Box3& box = host.box;
  const Carrier carrier = finder->find(prepared.frame, host);
  const Transform& roof = carrier.velo_from_roof;
  const Placement placement = placement_of(settings.placement, carrier, prepared.frame.labels);
  if (placement.left_out != LeftOut::no)
    spdlog::warn("vehicle {}: {}; an attack would leave it out", options.vehicle,
                 why_left_out(settings.placement, placement.left_out));
  warn_of_volume(settings.placement, bounds(adversary.mesh).sizes(), options.mesh.string());
  const Vec3d at = placement.velo_from_adversary.translation();
  const Vec3d& to_sun = prepared.frame.lighting.to_sun_velo;
  const double over_box = roof.translation().z() - box.bottom - box.height;
  settings.simulation =
      settings.for_unit(lidar, recorded_lidar_effects(settings.data, settings.rig), common.seed);
  const auto start = Clock::now();
  const Simulated simulated = simulate(prepared, placement, adversary, settings.simulation);
  const double seconds = seconds_since(start);
  common.provenance->add(settings.simulation);
  add_frames(*common.provenance, settings, {&options.frame, 1});
  remove_earlier_pictures(common.out);
  write_sights(prepared, simulated, common.out);
  write_sweep(common.out / "sweep.bin", simulated.sweep);
  for (const Measurement& measured : simulated.measurements)
    write_file(common.out / (escape_name(measured.name) + ".f32"),
               std::string_view(reinterpret_cast<const char*>(measured.data.data()),
                                measured.data.size() * sizeof(float)));
  print_table({{"roof", carrier.from_box
                            ? "the labelled box's" + (carrier.reason.empty() ? "" : ": " + carrier.reason)
                            : fmt::format("fitted, {:+.3f} m over the labelled box", over_box)},
               {"adversary stands",
                fmt::format("{} at ({:.2f}, {:.2f}, {:.2f}) m",
                            placement.support == Support::roof ? "on it" : "free", at.x(), at.y(), at.z())},
               {"pixels on the adversary", pixel_counts(prepared.frame, simulated)},
               {"returns on the adversary", std::to_string(simulated.adversary_points)},
               {"returns hidden by the scene", std::to_string(simulated.occluded_points)},
               {"returns that the adversary hides", std::to_string(simulated.removed_points)},
               {"share in view", percent(simulated.best_share())},
               {"measured returns with a ray of their own",
                fmt::format("{:.2f} %", 100 * prepared.index.assigned_share())},
               {"picture", (common.out / "image.png").string()}});
  nlohmann::json result = {
      {"adversary_pixels", simulated.adversary_pixels},
      {"adversary_points", simulated.adversary_points},
      {"occluded_points", simulated.occluded_points},
      {"removed_points", simulated.removed_points},
      {"visible_share", simulated.best_share()},
      {"rooftop",
       {{"from_box", carrier.from_box},
        {"reason", carrier.reason},
        {"velo", {roof(0, 3), roof(1, 3), roof(2, 3)}},
        {"heading_rad", std::atan2(roof(1, 0), roof(0, 0))},
        {"over_box_m", over_box}}},
      {"placement", text_of(settings.placement)},
      {"placed", to_json(settings.placement)},
      {"lost_points", simulated.lost_points},
      {"sweep_points", prepared.frame.sweep.size()},
      {"sweep_rays_assigned", prepared.index.assigned_share()},
      {"sweep_firings", prepared.index.firing_count()},
      {"sun", {{"choice", sun.word}, {"to_sun_velo", {to_sun.x(), to_sun.y(), to_sun.z()}}}},
      {"simulation", fields_json(settings.simulation)},
      {"seconds", seconds}};
  for (std::size_t k = 0; k < simulated.measurements.size(); ++k) {
    const Measurement &recorded = prepared.frame.measurements[k], &with = simulated.measurements[k];
    int changed = 0;
    for (std::size_t i = 0; i < with.data.size(); ++i) changed += with.data[i] != recorded.data[i];
    result["sensors"][with.name] = {{"shape", with.shape}, {"changed", changed}};
  }
  if (!prepared.frame.others.empty()) result["cameras"] = cameras_json(prepared.frame, simulated);
  return result;
}

void add_options(CLI::App& app, SimulateOptions& options) {
  app.add_option("--frame", options.frame, "frame id, e.g. 000008")->required();
  add_defaulted(app, "--vehicle", options.vehicle, "label index of the host, from 0");
  app.add_option("--mesh", options.mesh, "object, in metres (.glb, .gltf, .obj or .ply)")->required();
  options.insertion.add(app);
}

}  // namespace

Command simulate_command() {
  return command_of<SimulateOptions>({
      .name = "simulate",
      .help = "inserts a mesh on the roof of one vehicle: images, sweep, masks, depths",
      .example =
          "mirage simulate --data generated --frame 000000 --vehicle 0 --mesh out/attack/adversary.glb",
  });
}

}  // namespace mirage::cli
