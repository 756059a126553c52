// consumer DATA FRAME OUT.glb: a sphere on the roof of the frame's first car, in both sensors.
#include <algorithm>
#include <cstdio>

#include "exchange/gltf.h"
#include "geometry/mesh.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

int main(int, char** argv) {
  using namespace mirage;
  const std::filesystem::path data = argv[1];
  const PreparedFrame frame = prepare(read_frame(data, argv[2]), read_lidar_model(data / "rig.toml"));
  TexturedMesh sphere{icosphere(2), {}};
  for (Vec3d& vertex : sphere.mesh.vertices) vertex *= 0.5;  // m
  sphere.atlas.texels.assign(sphere.mesh.faces.size() * sphere.atlas.per_face(), Vec3d(0.8, 0.1, 0.1));
  for (const Label& label : frame.frame.labels) {
    if (label.type != "Car") continue;
    const Simulated seen = simulate(frame, on_roof(BoxRoofFinder().find(frame.frame, label)), sphere);
    write_adversary(argv[3], sphere);
    std::printf("%d pixels, %d returns\n", seen.adversary_pixels, seen.adversary_points);
    return seen.adversary_pixels + seen.adversary_points > 0 ? 0 : 1;
  }
  return 1;
}
