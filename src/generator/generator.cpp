#include "generator/generator.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "base/angles.h"
#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/names.h"
#include "base/random.h"
#include "generator/appearance.h"
#include "generator/labels.h"
#include "generator/moving_street.h"
#include "generator/street.h"
#include "sensors/lidar_sweep.h"
#include "sensors/ray_camera.h"

namespace mirage {
namespace {

FrameTruth make_truth(const generator::Street& street, const std::vector<int>& line, const RayImage& picture,
                      const std::vector<int>& objects) {
  FrameTruth truth{picture.depth, {picture.object.width, picture.object.height, 1}, {}};
  for (std::size_t i = 0; i < picture.object.data.size(); ++i)
    if (const int object = picture.object.data[i]; object >= 0)
      truth.instance.data[i] = static_cast<std::uint16_t>(line[static_cast<std::size_t>(object)] + 1);
  for (int object : objects) {
    std::uint32_t word = 0;
    if (object >= 0) {
      const auto k = static_cast<std::size_t>(object);
      word = static_cast<std::uint32_t>(line[k] + 1) << 16 | semantic_class(street.placed[k].type);
    }
    truth.returns.push_back(word);
  }
  return truth;
}

}  // namespace

std::uint16_t semantic_class(const std::string& type) {
  static const std::map<std::string, std::uint16_t> classes = {
      {"Car", 10}, {"Van", 10}, {"Truck", 18}, {"Misc", 20}, {"Pedestrian", 30}, {"Cyclist", 31}};
  const auto entry = classes.find(type);
  return entry == classes.end() ? 0 : entry->second;
}

namespace {

constexpr double kBehind = 60;  // m of street behind a car that looks back

/// Adds what the rig's other cameras see: pictures, and labels of what the first does not see.
void look_around(const Rig& rig, const generator::Street& street, const RayScene& scene,
                 const SceneLight& light, RayCameraSettings settings, std::uint64_t seed, std::uint64_t index,
                 std::span<const int> returned, Frame& frame, std::vector<int>& line) {
  std::vector<std::optional<Label>> unseen(street.placed.size());
  for (const Rig::Side& side : rig.others) {
    settings.seed = RandomStream(seed, "camera " + side.name, index).next_u32();
    RayImage picture =
        render(scene, side.calibration.camera, side.calibration.camera_from_velo, light, settings);
    generator::StreetLabels seen =
        generator::label_street(street, side.calibration, picture.object, returned);
    // Noise of its own: of a frame that no set of one camera has.
    generator::expose(picture.color, seed, index, index + ((frame.others.size() + 1) << 40));
    frame.others.push_back(
        {side.name, side.calibration, Lazy<ImageF>([image = std::move(picture.color)] { return image; })});
    for (std::size_t i = 0; i < unseen.size(); ++i) {
      if (line[i] >= 0 || seen.line[i] < 0) continue;
      Label& label = seen.labels[static_cast<std::size_t>(seen.line[i])];
      if (unseen[i] && unseen[i]->truncated <= label.truncated) continue;
      label.camera = static_cast<int>(frame.others.size());
      unseen[i] = std::move(label);
    }
  }
  for (std::size_t i = 0; i < unseen.size(); ++i)
    if (unseen[i]) {
      line[i] = static_cast<int>(frame.labels.size());
      frame.labels.push_back(std::move(*unseen[i]));
    }
}

}  // namespace

Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index, FrameTruth* truth) {
  const generator::Street street =
      generator::make_street(seed, index, rig.lidar.height, rig.look, rig.others.empty() ? 0 : kBehind);
  const SceneLight light = generator::make_light(seed, index);
  const RayScene scene(street.surfaces);
  RayCameraSettings settings;
  settings.sparse = true;
  settings.seed = RandomStream(seed, "camera", index).next_u32();
  const RayImage picture =
      render(scene, rig.calibration.camera, rig.calibration.camera_from_velo, light, settings);

  Frame frame;
  frame.id = fmt::format("{:06}", index);
  frame.image = picture.color;
  generator::expose(frame.image, seed, index, index);
  std::vector<int> objects;
  frame.sweep = simulate_sweep(scene, rig.lidar, RandomStream(seed, "lidar", index).next_u32(),
                               generated_sweep_effects(), &objects);
  frame.calibration = rig.calibration;
  generator::StreetLabels labelled =
      generator::label_street(street, rig.calibration, picture.object, objects);
  frame.labels = std::move(labelled.labels);
  frame.lighting = light.lighting;
  frame.camera = rig.camera;
  if (!rig.others.empty())
    look_around(rig, street, scene, light, settings, seed, index, objects, frame, labelled.line);
  if (truth) *truth = make_truth(street, labelled.line, picture, objects);
  return frame;
}

Frame generate_drive_frame(const Rig& rig, const generator::MovingStreet& street, const RayScene& standing,
                           std::uint64_t seed, std::uint64_t index, double time) {
  constexpr std::uint64_t kFramesOfDrive = 100000;
  const auto number = static_cast<std::uint64_t>(std::lround(time / kDriveStep));
  const std::uint64_t moment = index * kFramesOfDrive + number;
  const generator::Street now = street.at(time);
  const generator::Waypoint& own = street.own[street.step(time)];
  const Transform world_from_velo = own.pose();
  // Patterns stay where they are: the scene is traced in the world.
  Calibration placed = rig.calibration;
  placed.camera_from_velo = rig.calibration.camera_from_velo * world_from_velo.inverse();
  const SceneLight light = generator::make_light(seed, index);
  const RayScene scene(now.surfaces);
  RayCameraSettings settings;
  settings.sparse = true;
  settings.seed = RandomStream(seed, "drive camera", moment).next_u32();
  const RayImage picture = render(scene, rig.calibration.camera, placed.camera_from_velo, light, settings);

  Frame frame;
  frame.id = fmt::format("{:04}_{:06}", index, number);
  frame.image = picture.color;
  generator::expose(frame.image, seed, index, moment);
  std::vector<int> objects;
  UnitMotion motion{world_from_velo, world_from_velo.linear().transpose() * own.velocity, own.yaw_rate};
  std::deque<RayScene> parts;
  for (std::size_t k = 0; k < street.movers.size(); ++k) {
    parts.emplace_back(street.surfaces_of(k, time));
    motion.parts.push_back({&parts.back(), street.movers[k].way[street.step(time)].velocity});
  }
  frame.sweep = simulate_sweep(standing, rig.lidar, RandomStream(seed, "drive lidar", moment).next_u32(),
                               generated_sweep_effects(), &objects, &motion);
  frame.calibration = rig.calibration;
  generator::StreetLabels labelled = generator::label_street(now, placed, picture.object, objects);
  for (std::size_t k = 0; k < labelled.line.size(); ++k)
    if (labelled.line[k] >= 0)
      labelled.labels[static_cast<std::size_t>(labelled.line[k])].track = static_cast<int>(k);
  for (Label& label : labelled.labels) {
    BevBox& bev = label.box.bev;
    const Vec3d p = world_from_velo.inverse() * Vec3d(bev.x, bev.y, label.box.bottom);
    bev.x = p.x(), bev.y = p.y(), bev.yaw = wrap_angle(bev.yaw - own.yaw);
    label.box.bottom = p.z();
  }
  frame.labels = std::move(labelled.labels);
  frame.lighting = light.lighting;
  frame.lighting.to_sun_velo = world_from_velo.linear().transpose() * light.lighting.to_sun_velo;
  return frame;
}

// Rig files: [camera] here, [lidar] in sensors/lidar_model.

namespace {

/// A camera's table; `key`: its name in the file.
Calibration read_camera(const std::filesystem::path& file, const std::string& key, ConfigTable& table) {
  Calibration calibration;
  PinholeCamera& camera = calibration.camera;
  camera.width = static_cast<int>(table.number("width", 1, 16384));
  camera.height = static_cast<int>(table.number("height", 1, 16384));
  if (static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height) > kMostPixels)
    throw InputError(file.string(), key + ".width, " + key + ".height",
                     fmt::format("{}×{} are more than {} pixels", camera.width, camera.height, kMostPixels),
                     "give a smaller picture");
  camera.fx = table.number("fx", 1, 1e5);
  camera.fy = table.number("fy", 1, 1e5);
  camera.cx = table.number("cx", 0, camera.width - 1);
  camera.cy = table.number("cy", 0, camera.height - 1);
  const auto pose = table.numbers("camera_from_velo", 12, -100, 100);
  for (int i = 0; i < 12; ++i) calibration.camera_from_velo.matrix()(i / 4, i % 4) = pose[i];
  table.check_all_known();
  const Eigen::Matrix3d r = calibration.camera_from_velo.linear();
  if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || r.determinant() < 0)
    throw InputError(file.string(), key + ".camera_from_velo", "its 3x3 part is not a rotation",
                     "give an orthonormal, right-handed matrix [R | t], row by row");
  return calibration;
}

}  // namespace

Rig read_rig(const std::filesystem::path& file) {
  ConfigTable root = ConfigTable::read(file);
  ConfigTable first = root.table("camera");
  root.skip("lidar");
  nlohmann::json whole = read_toml(file);
  Rig rig;
  if (root.has("look")) rig.look = parse_look(root.text("look"), file.string(), "look");
  if (root.has("cameras")) {
    ConfigTable cameras = root.table("cameras");
    for (const auto& [name, values] : whole.at("cameras").items()) {
      if (!frame_id_problem(name).empty())
        throw InputError(file.string(), "cameras", "a camera's name can be no folder's",
                         "call it as [cameras.CAM_BACK]");
      ConfigTable table = cameras.table(name);
      rig.others.push_back({name, read_camera(file, "cameras." + name, table)});
    }
  }
  root.check_all_known();
  rig.name = file.stem().string();
  if (first.has("name")) rig.camera = first.text("name");
  rig.calibration = read_camera(file, "camera", first);
  rig.lidar = read_lidar_model(file);
  rig.text = read_text(file, kLargestToml);
  if (const nlohmann::json unit = lidar_table(file); whole["lidar"] != unit) {
    whole["lidar"] = unit;
    rig.text = toml_text(whole);
  }
  return rig;
}

Rig with_look(Rig rig, Look look) {
  if (rig.look == look) return rig;
  rig.look = look;
  nlohmann::json whole = parse_toml(rig.text, rig.name);
  whole["look"] = name_of(look);
  rig.text = toml_text(whole);
  return rig;
}

Rig with_lidar(Rig rig, const std::string& unit) {
  const std::filesystem::path file = lidar_file(unit);
  const double height = rig.lidar.height;
  rig.lidar = read_lidar_model(file);
  rig.lidar.height = height;
  rig.name = fmt::format("{}+{}", rig.name, file.stem().string());
  nlohmann::json whole = parse_toml(rig.text, rig.name);
  whole["lidar"] = lidar_table(file);
  whole["lidar"]["height"] = height;
  rig.text = toml_text(whole);
  return rig;
}

}  // namespace mirage
