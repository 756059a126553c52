// The Blender worker, and the rasteriser and LiDAR against it. Skipped where Blender is not installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cstdlib>

#include "base/error.h"
#include "base/image_io.h"
#include "fixture.h"
#include "validation/fidelity.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

class Blender : public ::testing::Test {
 protected:
  void SetUp() override {
    if (find_program("blender").empty()) GTEST_SKIP() << "blender is not installed";
    setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
    if (!worker_) worker_ = std::make_unique<BlenderWorker>(test::scratch("blender.log"));
  }
  static void TearDownTestSuite() { worker_.reset(); }
  static std::unique_ptr<BlenderWorker> worker_;
};
std::unique_ptr<BlenderWorker> Blender::worker_;

TEST_F(Blender, AnswersAPing) {
  EXPECT_EQ(worker_->request({{"job", "ping"}}, 10).value("version", ""), worker_->version());
  EXPECT_FALSE(worker_->version().empty());
}

TEST_F(Blender, MatchedLightEqualsTheHardRasteriser) {
  // An off-centre camera, near and far, front and back light, several texture resolutions.
  struct Case {
    double x, y, yaw;
    int resolution;
    Vec3d to_sun;
  };
  int index = 0, pixels = 0;
  double error = 0;
  for (const Case& c : {Case{9, 1.5, 0.4, 5, {0.4, 0.5, 0.77}}, Case{25, -6, 2.0, 5, {-0.6, 0.2, 0.7}},
                        Case{6, -2, -1.1, 3, {0.9, -0.3, 0.2}}}) {
    PreparedFrame prepared = test::made_up_frame(c.x, c.y, c.yaw);
    prepared.frame.lighting.to_sun_velo = c.to_sun.normalized();
    const auto scene = test::host_scene_of(prepared, test::random_mesh(c.resolution + index, c.resolution),
                                           "matched" + std::to_string(index));
    ++index;
    const MatchedLight matched = matched_light(*worker_, scene);
    write_srgb(scene.scratch / "raster.png", matched.raster);
    write_srgb(scene.scratch / "cycles.png", matched.cycles);
    EXPECT_GE(matched.mask_iou, 0.9999) << "x = " << c.x;
    EXPECT_GT(matched.mask_both, 500);
    error += matched.mae * matched.mask_either;
    pixels += matched.mask_either;
    std::printf("x = %g: mask IoU %.6f, MAE %.3g, max %.3g, %d pixels\n", c.x, matched.mask_iou, matched.mae,
                matched.max_error, matched.mask_both);
  }
  // A pixel whose centre lies within float32 of a texel's border may show either texel: about one in
  // thousands.
  EXPECT_LE(error / pixels, 1e-4);
  std::printf("together: MAE %.3g\n", error / pixels);
}

TEST_F(Blender, FacesSeenFromBehindAreShadedByTheirWinding) {
  const PreparedFrame prepared = test::made_up_frame();
  TexturedMesh inside_out = test::random_mesh(4);
  for (Face& f : inside_out.mesh.faces) std::swap(f[1], f[2]);
  const MatchedLight matched =
      matched_light(*worker_, test::host_scene_of(prepared, inside_out, "inside-out"));
  EXPECT_LE(matched.mae, 1e-4);
}

TEST_F(Blender, LidarRangesAgree) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "lidar");
  const Simulated simulated = simulate(prepared, *scene.host, scene.rooftop, scene.adversary);
  ASSERT_GT(simulated.adversary_points, 50);
  const LidarCheck check = check_lidar(*worker_, scene, simulated);
  EXPECT_EQ(check.disagreements, 0);
  EXPECT_LE(check.range_error, 1e-4);
  std::printf("%d rays, %d returns, range error %.3g m\n", check.rays, check.returns, check.range_error);
}

TEST_F(Blender, SkyGivesTheLightModelsIrradiance) {
  // An unoccluded convex body under the sky alone receives what the light-weight ambient terms say.
  PreparedFrame prepared = test::made_up_frame();
  prepared.frame.lighting.sun = Vec3d::Zero();
  TexturedMesh ball{icosphere(2), {1, std::vector<Vec3d>(320, Vec3d::Constant(0.5))}};
  for (Vec3d& v : ball.mesh.vertices) v *= 0.5;
  const auto scene = test::host_scene_of(prepared, ball, "sky");
  RenderJob job;
  job.scene = scene.glb;
  job.output = scene.scratch / "sky.exr";
  job.rect = matched_light(*worker_, scene).rect;
  job.samples = 64;
  const ImageF plain = render(*worker_, job).rgba;
  job.effects.sky = true;
  const ImageF sky = render(*worker_, job).rgba;
  EXPECT_LE(mean_absolute_error(plain, sky), 0.004);
}

TEST_F(Blender, FullLightDarkensTheRoofAndKeepsThePhotographElsewhere) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "full");
  const Simulated simulated = simulate(prepared, *scene.host, scene.rooftop, scene.adversary);
  const FullLight full = full_light(*worker_, scene, simulated);
  write_srgb(scene.scratch / "full.png", full.image);
  EXPECT_GT(mean_absolute_error(full.raster, full.cycles, full.mask), 1e-3);
  EXPECT_LT(mean_absolute_error(full.raster, full.cycles, full.mask), 0.2);
  int changed = 0;
  for (int v = 0; v < full.image.height; ++v)
    for (int u = 0; u < full.image.width; ++u) {
      const bool inside = u >= full.rect.u0 && u < full.rect.u1 && v >= full.rect.v0 && v < full.rect.v1;
      const bool same = full.image.at(u, v) == prepared.frame.image.at(u, v);
      if (!inside) {
        ASSERT_TRUE(same) << u << ", " << v;
      }
      changed += !same;
    }
  EXPECT_GT(changed, simulated.adversary_pixels / 2);
}

TEST_F(Blender, AKilledWorkerIsStartedAgain) {
  BlenderWorker worker(test::scratch("killed.log"));
  const pid_t first = worker.pid();
  kill(first, SIGKILL);
  EXPECT_TRUE(worker.request({{"job", "ping"}}, 30).value("ok", false));
  EXPECT_EQ(worker.restarts(), 1);
  EXPECT_NE(worker.pid(), first);
}

TEST_F(Blender, ABadJobIsAFailureAndTheWorkerLivesOn) {
  const pid_t pid = worker_->pid();
  try {
    worker_->request(
        {{"job", "render"}, {"scene", "/nowhere.glb"}, {"rect", {0, 0, 1, 1}}, {"output", "/dev/null"}}, 30);
    ADD_FAILURE();
  } catch (const Failure& failure) {
    EXPECT_THAT(failure.what(), HasSubstr("/nowhere.glb"));
  }
  EXPECT_TRUE(worker_->request({{"job", "ping"}}, 10).value("ok", false));
  EXPECT_EQ(worker_->pid(), pid);
}

TEST(BlenderProcess, NoBlenderOnPathIsOneClearLine) {
  const std::string path = std::getenv("PATH");
  setenv("PATH", "/nonexistent", 1);
  try {
    BlenderWorker worker(test::scratch("none.log"));
    ADD_FAILURE();
  } catch (const InputError& error) {
    EXPECT_STREQ(error.what(), "blender: not found on PATH; install it with apt-get install blender");
  }
  setenv("PATH", path.c_str(), 1);
}

}  // namespace
}  // namespace mirage
