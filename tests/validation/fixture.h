// A random adversary on a car in KITTI's camera, in a made-up frame.
#pragma once

#include <filesystem>
#include <string>

#include "base/random.h"
#include "exchange/gltf.h"
#include "geometry/mesh.h"
#include "simulation/insertion.h"
#include "validation/fidelity/ladders.h"

namespace mirage::test {

inline std::filesystem::path scratch(const std::string& name) {
  const std::filesystem::path folder = std::filesystem::path(MIRAGE_BUILD) / "test-validation";
  std::filesystem::create_directories(folder);
  return folder / name;
}

inline TexturedMesh random_mesh(std::uint64_t seed, int resolution = 5) {
  RandomStream random(seed, "validation test mesh");
  TexturedMesh textured{icosphere(2), {resolution, {}}};
  for (Vec3d& v : textured.mesh.vertices)
    v = v.cwiseProduct(Vec3d(0.7, 0.6, 0.4)) * random.uniform(0.85, 1.15);
  textured.atlas.texels.resize(textured.mesh.faces.size() * textured.atlas.per_face());
  for (Vec3d& t : textured.atlas.texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  return textured;
}

/// A frame with one car at (x, y), KITTI's off-centre camera with a slight roll, and a small made-up LiDAR.
inline PreparedFrame made_up_frame(double x = 9, double y = 1.5, double yaw = 0.4) {
  Frame frame;
  frame.id = "made-up";
  frame.image = ImageF(1242, 375, 3);
  for (int v = 0; v < frame.image.height; ++v)
    for (int u = 0; u < frame.image.width; ++u)
      for (int c = 0; c < 3; ++c)
        frame.image.at(u, v, c) = 0.2f + 0.1f * static_cast<float>(((u / 8 + v / 8) % 2 + c) % 3);
  frame.calibration.camera = {721.5377, 721.5377, 609.5593, 172.854, 1242, 375};
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.calibration.camera_from_velo.linear() =
      Eigen::AngleAxisd(0.015, Vec3d(0.3, 0.5, 0.8).normalized()).toRotationMatrix() * axes;
  frame.calibration.camera_from_velo.translation() = Vec3d(0.06, -0.08, -0.27);
  Label car;
  car.type = "Car";
  car.left = 500, car.top = 150, car.right = 640, car.bottom = 230;
  car.box = {{x, y, 4.1, 1.7, yaw}, -1.7, 1.5};
  frame.labels.push_back(car);
  LidarModel lidar;
  lidar.name = "made-up";
  for (int beam = 0; beam < 32; ++beam) lidar.beams.push_back({0.05 - 0.006 * beam, 0, 0, 0});
  lidar.azimuth_step = 0.003;
  lidar.azimuth_min = -0.8;
  lidar.azimuth_max = 0.8;
  lidar.range_min = 0.9;
  lidar.range_max = 120;
  lidar.velo_from_lidar.translation() = Vec3d(0.1, 0, 0.05);
  return prepare(std::move(frame), lidar);
}

/// The scene of the frame's car with the mesh on it, exported to a .glb of that name.
inline HostScene host_scene_of(const PreparedFrame& prepared, const TexturedMesh& adversary,
                               const std::string& name) {
  HostScene scene;
  scene.prepared = &prepared;
  scene.host = &prepared.frame.labels[0];
  scene.placement = on_roof(BoxRoofFinder().find(prepared.frame, *scene.host));
  scene.adversary = adversary;
  scene.placed = place(adversary, scene.placement);
  scene.glb = scratch(name + ".glb");
  scene.scratch = scratch(name);
  std::filesystem::create_directories(scene.scratch);
  scene.samples = 16;
  write_scene(scene.glb, host_scene(prepared.frame, scene.placement, adversary, name));
  return scene;
}

}  // namespace mirage::test
