// No stop-gradient anywhere: from a proposal's logit of the real detector to the adversary, one sensor at a
// time.
#include <gtest/gtest.h>

#include <algorithm>

#include "attack/attack.h"
#include "attack/tiny_world.h"
#include "base/files.h"
#include "generator/generator.h"

namespace mirage {
namespace {

struct Norms {
  double vertices = 0, texels = 0;
};

Norms norms(const AdversaryGradient& gradient) {
  Norms result;
  for (const Vec3d& d : gradient.vertices) {
    EXPECT_TRUE(d.allFinite());
    result.vertices += d.norm();
  }
  for (const Vec3d& d : gradient.texels) {
    EXPECT_TRUE(d.allFinite());
    result.texels += d.norm();
  }
  return result;
}

/// The adversary on a car 12 m ahead in an otherwise empty street.
TEST(GradientFlow, FromALogitToTheAdversaryThroughEachSensorAlone) {
  if (!std::filesystem::exists(executable_folder() / "plugins/fusion.so"))
    GTEST_SKIP() << "the fusion plugin was not built (MIRAGE_DETECTORS)";
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  DetectorOptions options;
  options.fresh = true;
  options.seed = 3;
  options.threads = 1;
  const auto detector = load_detector(options);

  const Rig rig = read_rig(shipped_file("scenes/rigs/kitti64.toml"));
  Frame frame;
  frame.calibration = rig.calibration;
  frame.image = ImageF(rig.calibration.camera.width, rig.calibration.camera.height, 3, 0.3f);
  for (double x = 6; x < 40; x += 0.5)
    for (double y = -6; y <= 6; y += 0.3) frame.sweep.push_back({float(x), float(y), -1.73f, 0.2f});
  Label host;
  host.type = "Car";
  host.box = {{12, 0.5, 4, 1.7, 0.1}, -1.73, 1.5};
  frame.labels = {host};
  const PreparedFrame prepared = prepare(frame, rig.lidar);
  const Simulated simulated =
      simulate(prepared, on_roof(BoxRoofFinder().find(frame, host)), random_adversary(1));
  ASSERT_GT(simulated.adversary_pixels, 500);
  ASSERT_GT(simulated.adversary_points, 20);

  const SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration};
  const auto proposals = detector->forward(view, 0, true);
  ASSERT_FALSE(proposals.empty());
  std::size_t nearest = 0;
  const auto distance = [&](const Detection& p) { return std::hypot(p.box.bev.x - 12, p.box.bev.y - 0.5); };
  for (std::size_t i = 0; i < proposals.size(); ++i)
    if (distance(proposals[i]) < distance(proposals[nearest])) nearest = i;
  std::vector<double> d_logits(proposals.size(), 0);
  d_logits[nearest] = 1;
  const SensorGradient gradient = detector->backward(d_logits);

  const Norms lidar = norms(simulate_vjp(simulated, ImageF(), gradient.points));
  const Norms image = norms(simulate_vjp(simulated, gradient.image, {}));
  std::printf("|d logit / d vertices| LiDAR %.2e, image %.2e; |d logit / d texels| image %.2e\n",
              lidar.vertices, image.vertices, image.texels);
  EXPECT_GT(lidar.vertices, 0);
  EXPECT_EQ(lidar.texels, 0);  // reflectivity belongs to the material
  EXPECT_GT(image.vertices, 0);
  EXPECT_GT(image.texels, 0);
}

}  // namespace
}  // namespace mirage
