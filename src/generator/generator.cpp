#include "generator/generator.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <numbers>
#include <optional>
#include <utility>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "base/types.h"
#include "geometry/box.h"
#include "sensors/camera.h"
#include "sensors/lidar_sweep.h"

namespace mirage {
namespace {

FrameTruth make_truth(const generator::Street& street, const std::vector<int>& line, const RayImage& picture,
                      const std::vector<int>& objects) {
  FrameTruth truth{picture.depth, {picture.object.width, picture.object.height, 1}, {}};
  for (std::size_t i = 0; i < picture.object.data.size(); ++i)
    if (const int object = picture.object.data[i]; object >= 0)
      truth.instance.data[i] = static_cast<std::uint16_t>(line[as_size(object)] + 1);
  for (int object : objects) {
    std::uint32_t word = 0;
    if (object >= 0) {
      const auto k = as_size(object);
      word = static_cast<std::uint32_t>(line[k] + 1) << 16 | semantic_class(street.placed[k].type);
    }
    truth.returns.push_back(word);
  }
  return truth;
}

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
    // Its own noise: that of a frame index that no set of one camera has.
    generator::expose(picture.color, seed, index, index + ((frame.others.size() + 1) << 40));
    frame.others.push_back(
        {side.name, side.calibration, Lazy<ImageF>([image = std::move(picture.color)] { return image; })});
    for (std::size_t i = 0; i < unseen.size(); ++i) {
      if (line[i] >= 0 || seen.line[i] < 0) continue;
      Label& label = seen.labels[as_size(seen.line[i])];
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

// Rig files: [camera] here, [lidar] in sensors/lidar_model.

/// A camera's table; `key`: its name in the file.
Calibration read_camera(const std::filesystem::path& file, const std::string& key, ConfigTable& table) {
  Calibration calibration;
  PinholeCamera& camera = calibration.camera;
  camera.width = static_cast<int>(table.number("width", 1, 16384));
  camera.height = static_cast<int>(table.number("height", 1, 16384));
  if (static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height) > kMaxPixels)
    throw InputError(file.string(), key + ".width, " + key + ".height",
                     fmt::format("{}×{} are more than {} pixels", camera.width, camera.height, kMaxPixels),
                     "give a smaller picture");
  camera.fx = table.number("fx", 1, 1e5);
  camera.fy = table.number("fy", 1, 1e5);
  camera.cx = table.number("cx", 0, camera.width - 1);
  camera.cy = table.number("cy", 0, camera.height - 1);
  const auto pose = table.numbers("camera_from_velo", 12, -100, 100);
  for (int i = 0; i < 12; ++i) calibration.camera_from_velo.matrix()(i / 4, i % 4) = pose[as_size(i)];
  table.check_all_known();
  const Eigen::Matrix3d r = calibration.camera_from_velo.linear();
  if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || r.determinant() < 0)
    throw InputError(file.string(), key + ".camera_from_velo", "its 3x3 part is not a rotation",
                     "give an orthonormal, right-handed matrix [R | t], row by row");
  return calibration;
}

}  // namespace

std::uint16_t semantic_class(const std::string& type) {
  static const std::map<std::string, std::uint16_t> classes = {
      {"Car", 10}, {"Van", 10}, {"Truck", 18}, {"Misc", 20}, {"Pedestrian", 30}, {"Cyclist", 31}};
  const auto entry = classes.find(type);
  return entry == classes.end() ? 0 : entry->second;
}

Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index, FrameTruth* truth) {
  const generator::Street street = generator::make_street(seed, index, rig.lidar.height, rig.look,
                                                          rig.others.empty() ? 0 : generator::kBehind);
  const SceneLight light = generator::make_light(seed, index);
  const RayScene scene(street.surfaces);
  const RayCameraSettings settings{.seed = RandomStream(seed, "camera", index).next_u32(), .sparse = true};
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
  const RayCameraSettings settings{.seed = RandomStream(seed, "drive camera", moment).next_u32(),
                                   .sparse = true};
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
    if (labelled.line[k] >= 0) labelled.labels[as_size(labelled.line[k])].track = static_cast<int>(k);
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
        throw InputError(file.string(), "cameras", "a camera's name cannot be a folder's",
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
  rig.text = read_text(file, kMaxTomlBytes);
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

namespace mirage::generator {
namespace {

constexpr double kMinProjectedDepth = 0.3;  // m, corners nearer than this to the camera's plane lie on it
constexpr int kProbes = 3000;               // rays a thing to count its own pixels
constexpr int kRows = 25;  // pixels of height that make a thing without returns one to be found (KITTI)

}  // namespace

SceneLight make_light(std::uint64_t seed, std::uint64_t index) {
  RandomStream random(seed, "light", index);
  const auto f = [&](double a, double b) { return static_cast<float>(random.uniform(a, b)); };
  SceneLight light;
  Lighting& l = light.lighting;
  const double azimuth = random.uniform(-std::numbers::pi, std::numbers::pi),
               elevation = random.uniform(0.25, 1.05);
  l.to_sun_velo = unit_vector(azimuth, elevation);
  const double overcast = random.uniform() < 0.25 ? random.uniform(0.6, 1.0) : random.uniform(0.0, 0.2);
  const float exposure = f(0.85, 1.5);
  const float warm = std::clamp(1.2f - static_cast<float>(elevation), 0.f, 1.f);
  const float strength = 2.3f * (1 - 0.93f * static_cast<float>(overcast)) * exposure;
  const Vec3f sun = strength * Vec3f(1.04f, 0.97f - 0.05f * warm, 0.86f - 0.18f * warm);
  l.sun = sun.cast<double>();
  const float o = static_cast<float>(overcast);
  const float bright = f(0.3, 0.85) * exposure;
  light.sky.horizon = bright * ((1 - o) * Vec3f(0.80f, 0.92f, 1.05f) + o * Vec3f(0.95f, 0.96f, 1.0f));
  light.sky.zenith = bright * ((1 - o) * Vec3f(0.11f, 0.21f, 0.43f) + o * Vec3f(0.8f, 0.82f, 0.86f));
  light.sky.glow = (1 - o) * 0.9f * exposure;
  light.sky.clouds = random.uniform() < 0.7 ? f(0.2, 0.75) : 0;
  light.sky.variant = random.next_u32();
  light.sky.seen = f(1.0, 1.9);
  const Vec3f to_sun = l.to_sun_velo.cast<float>(), sky = light.sky.irradiance(to_sun);
  // Light that bounces from ground and walls: a mean albedo of 0.12, a share of them in the sun.
  const Vec3f bounce =
      0.16f * (0.45f * std::max(0.f, to_sun.z()) * sun + 0.6f * sky).cwiseProduct(Vec3f(1.05f, 1, 0.9f));
  l.ambient = bounce.cast<double>();
  // Lighting's hemisphere term adds to the ambient: with a share (1 + n·up)/2 of open sky in view.
  l.hemisphere = (sky - bounce).cwiseMax(0.f).cast<double>();
  return light;
}

void expose(ImageF& image, std::uint64_t seed, std::uint64_t index, std::uint64_t moment) {
  soften(image, RandomStream(seed, "lens", index).uniform(0.5, 0.85));
  RandomStream level(seed, "sensor noise level", index);
  const double shot = level.uniform(2e-5, 1.2e-4), read = level.uniform(0.5e-3, 2e-3);
  for (int v = 0; v < image.height; ++v) {
    RandomStream random(seed, "sensor noise", moment * 100003 + as_size(v));
    for (int i = 0; i < image.width * 3; ++i) {
      float& x = image.pixel(0, v)[i];
      x = std::max(0.f, x + static_cast<float>(random.normal() * noise_sigma(x, shot, read)));
    }
  }
}

StreetLabels label_street(const Street& street, const Calibration& calibration, const Image<int>& object,
                          std::span<const int> returned) {
  const PinholeCamera& camera = calibration.camera;
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const std::size_t count = street.placed.size();
  std::vector<int> visible(count, 0), first(count, object.height), last(count, -1), returns(count, 0);
  for (int v = 0; v < object.height; ++v)
    for (int u = 0; u < object.width; ++u)
      if (const int id = object.at(u, v); id >= 0)
        ++visible[as_size(id)], first[as_size(id)] = std::min(first[as_size(id)], v), last[as_size(id)] = v;
  for (int id : returned)
    if (id >= 0) ++returns[as_size(id)];

  std::vector<Label> labels(count);
  parallel_for(count, [&](std::size_t i) {
    if (returns[i] == 0 && last[i] - first[i] + 1 < kRows) return;
    const BevBox& place = street.placed[i].box.bev;
    if (visible[i] == 0 &&
        (calibration.camera_from_velo * Vec3d(place.x, place.y, 0)).z() < kMinProjectedDepth)
      return;
    std::vector<Mesh> meshes;
    for (const Surface& s : street.surfaces)
      if (s.object == static_cast<int>(i)) meshes.push_back(s.mesh);
    // KITTI's boxes in the picture are those around the corners of the 3-D box, which is wider than the
    // outline of a round body.
    PictureBox full{1e9, 1e9, -1e9, -1e9};
    for (const Vec3d& corner : corners(street.placed[i].box)) {
      Vec3d p = calibration.camera_from_velo * corner;
      p.z() = std::max(p.z(), kMinProjectedDepth);
      const Vec2d pixel = camera.project(p);
      full = united(full, {pixel.x(), pixel.y(), pixel.x(), pixel.y()});
    }
    const PictureBox seen = within(full, camera.width, camera.height);
    if (seen.right - seen.left < 1 || seen.bottom - seen.top < 1) return;
    // The thing alone: how many pixels would it cover?
    const RayCaster alone(meshes);
    const int step = std::max(1, static_cast<int>(std::sqrt(area(seen) / kProbes)));
    int own = 0, shown = 0;
    for (int v = static_cast<int>(seen.top); v <= static_cast<int>(seen.bottom); v += step)
      for (int u = static_cast<int>(seen.left); u <= static_cast<int>(seen.right); u += step) {
        const Ray ray{velo_from_camera.translation().cast<float>(),
                      (velo_from_camera.linear() * camera.unproject(u, v, 1)).cast<float>(), 0.05f};
        if (!alone.occluded(ray)) continue;
        ++own;
        if (object.at(u, v) == static_cast<int>(i)) ++shown;
      }
    const double share = own > 0 ? static_cast<double>(shown) / own : 1;
    Label& label = labels[i];
    label.type = street.placed[i].type;
    label.box = street.placed[i].box;
    label.truncated = std::clamp(1 - area(seen) / std::max(area(full), 1e-9), 0.0, 1.0);
    label.occluded = visible[i] == 0 ? 3 : share > 0.8 ? 0 : share > 0.35 ? 1 : 2;
    label.left = seen.left, label.top = seen.top, label.right = seen.right, label.bottom = seen.bottom;
  });
  StreetLabels out;
  for (Label& label : labels) {
    out.line.push_back(label.type.empty() ? -1 : static_cast<int>(out.labels.size()));
    if (!label.type.empty()) out.labels.push_back(std::move(label));
  }
  return out;
}

}  // namespace mirage::generator
