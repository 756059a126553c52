// Writes the scene of the add-on's tests: make_scene OUT.glb. A noisy adversary on a car, seen by a camera
// with an off-centre principal point and pixels that are not square, over a made-up photograph.
#include <cstdio>

#include "base/random.h"
#include "exchange/gltf.h"
#include "geometry/mesh.h"

int main(int count, char** arguments) {
  using namespace mirage;
  if (count != 2) {
    std::fputs("usage: make_scene OUT.glb\n", stderr);
    return 2;
  }
  RandomStream random(11, "add-on test scene");
  TexturedMesh adversary{icosphere(1), {5, {}}};
  for (Vec3d& v : adversary.mesh.vertices)
    v = v.cwiseProduct(Vec3d(0.7, 0.6, 0.4)) * random.uniform(0.85, 1.15);
  adversary.atlas.texels.resize(adversary.mesh.faces.size() * adversary.atlas.per_face());
  for (Vec3d& t : adversary.atlas.texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  Frame frame;
  frame.image = ImageF(320, 120, 3);
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 320; ++u)
      for (int c = 0; c < 3; ++c)
        frame.image.at(u, v, c) = v < 60 ? 0.3f + 0.1f * static_cast<float>(c)
                                         : 0.1f + 0.08f * static_cast<float>((u / 16 + v / 16) % 2);
  frame.calibration.camera = {190, 210, 170.3, 49.6, 320, 120};
  frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  frame.calibration.camera_from_velo.translation() = Vec3d(0.06, -0.08, -0.27);
  Label host;
  host.type = "Car";
  host.left = 120, host.top = 50, host.right = 200, host.bottom = 110;
  host.box = {{7, 0.6, 4.1, 1.7, 0.3}, -1.7, 1.5};
  const Placement roof = on_roof(BoxRoofFinder().find(frame, host));
  write_scene(arguments[1], host_scene(frame, roof, adversary, "add-on test"));
  return 0;
}
