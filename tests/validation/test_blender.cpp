// The Blender worker, and the rasteriser and LiDAR against it. Skipped where Blender is not installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <memory>

#include "attack/attack.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "exchange/mesh_files.h"
#include "fixture.h"
#include "geometry/mesh.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"
#include "validation/fidelity/ladders.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/reference_renderer.h"

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
  const nlohmann::json answer = worker_->request({{"job", "ping"}}, 10);
  EXPECT_EQ(answer.value("version", ""), worker_->version());
  EXPECT_FALSE(worker_->version().empty());
}

TEST_F(Blender, SaysWhatItFoundAndHasAllThatMirageAsksFor) {
  const nlohmann::json found = worker_->request({{"job", "ping"}}, 10).at("found");
  EXPECT_EQ(found.at("version"), worker_->version());
  for (const char* input : {"specular", "coat", "coat roughness"})
    EXPECT_TRUE(found.at("principled_inputs").at(input).is_string()) << input;
  for (const char* argument : {"shading", "lighting", "merge"})
    EXPECT_TRUE(found.at("importer_arguments").at(argument).is_string()) << argument;
  EXPECT_TRUE(found.at("denoiser").is_boolean());
  EXPECT_THAT(read_file(test::scratch("blender.log")), HasSubstr("blender_worker.py found: {"));
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
    const auto scene =
        test::host_scene_of(prepared, test::random_mesh(as_size(c.resolution + index), c.resolution),
                            "matched" + std::to_string(index));
    ++index;
    const MatchedLight matched = matched_light(*worker_, scene);
    write_srgb(scene.scratch / "raster.png", matched.raster);
    write_srgb(scene.scratch / "cycles.png", matched.cycles);
    EXPECT_GE(matched.mask_iou, 0.9999) << "x = " << c.x;
    EXPECT_GT(matched.mask_both, 500);
    EXPECT_LE(matched.depth_error, 1e-3) << "x = " << c.x;
    EXPECT_LE(matched.depth_error_mean, 1e-4) << "x = " << c.x;
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
  const Simulated simulated = simulate(prepared, scene.placement, scene.adversary);
  ASSERT_GT(simulated.adversary_points, 50);
  const MatchedResult check = check_lidar(*worker_, scene, simulated);
  EXPECT_EQ(check.hit_disagreements, 0);
  EXPECT_LE(check.range_error, 1e-4);
  std::printf("%d rays, %d returns, range error %.3g m\n", check.rays, check.returns, check.range_error);
}

TEST_F(Blender, SkyGivesTheLightModelsIrradiance) {
  // An unoccluded convex body under the sky alone receives the irradiance of the light-weight ambient terms.
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
  const ImageF plain = worker_->render(job).rgba;
  job.effects.sky = true;
  const ImageF sky = worker_->render(job).rgba;
  EXPECT_LE(mean_absolute_error(plain, sky), 0.004);
}

TEST_F(Blender, FullLightDarkensTheRoofAndKeepsThePhotographElsewhere) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "full");
  const Simulated simulated = simulate(prepared, scene.placement, scene.adversary);
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

TEST_F(Blender, TheLadderComesCloserToTheFullRender) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "ladder");
  const Simulated simulated = simulate(prepared, scene.placement, scene.adversary);
  const FullLight full = full_light(*worker_, scene, simulated);
  const LightLadder ladder = light_ladder(*worker_, scene, full);
  std::map<std::string, const LadderRung*> rungs;
  for (const LadderRung& rung : ladder.rungs) {
    rungs[rung.effect] = &rung;
    EXPECT_TRUE(rungs.contains(rung.base) || rung.base == "centres" || rung.base == "reference") << rung.base;
    EXPECT_TRUE(std::isfinite(rung.change.relative) && std::isfinite(rung.to_full.flip)) << rung.effect;
    EXPECT_EQ(rung.picture.width, full.rect.width());
  }
  const auto off = [&](const char* effect) { return rungs.at(effect)->to_full.relative; };
  EXPECT_LT(off("all"), off("+shadows+occlusion"));
  EXPECT_LT(off("+bounces4"), off("+pixel area"));
  EXPECT_LT(off("full"), off("full, 4 samples"));
  EXPECT_EQ(rungs.at("hard")->change.mae, 0);
  EXPECT_GT(rungs.at("soft")->change.mae, 0);
  EXPECT_GT(rungs.at("sRGB shading")->change.relative, 0.02);
  // The shadow that the object casts lies beside it, not on it.
  EXPECT_GT(rungs.at("+cast shadow")->crop.mae, 0);
  EXPECT_LT(rungs.at("+cast shadow")->change.mae, 0.02);
  EXPECT_GT(rungs.at("+clear sky")->change.relative, 0.01);
  EXPECT_LT(rungs.at("+clear sky")->change.relative, 0.6);
  EXPECT_GT(rungs.at("+car paint")->change.mae, 0);
  // The shadow beside the object is not an error of the object.
  EXPECT_NEAR(rungs.at("+cast shadow")->error.unbiased, rungs.at("+shadows")->error.unbiased,
              0.2 * rungs.at("+shadows")->error.unbiased);
  // Noise is in the floor, and not in the unbiased error.
  EXPECT_NEAR(rungs.at("hard")->error.drawn, rungs.at("hard")->error.unbiased, 1e-12);
  EXPECT_GT(rungs.at("full, 4 samples")->error.floor, 2 * rungs.at("full")->error.floor);
  EXPECT_GT(rungs.at("full, 4 samples")->error.drawn, 4 * rungs.at("full, 4 samples")->error.unbiased);
  EXPECT_GT(ladder.reference.noise, 0);
  EXPECT_LT(ladder.reference.noise, std::sqrt(rungs.at("full")->error.floor));
}

TEST_F(Blender, FullLightHasNoErrorAgainstItselfButItsNoise) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "itself");
  const Simulated simulated = simulate(prepared, scene.placement, scene.adversary);
  const FullLight full = full_light(*worker_, scene, simulated);
  RenderJob job = job_for(scene, full.rect);
  job.effects = full_effects();
  const Halves reference = over(render_halves(*worker_, job, scene.seed, RenderStream::reference),
                                full.visible, crop(prepared.frame.image, full.rect));
  EXPECT_NE(reference.first.data, reference.second.data);
  EXPECT_NE(reference.first.data, full.radiance.first.data);
  const SquaredError itself = error_to(reference, full.radiance, full.coverage, full);
  std::printf("full light against itself: plain %.3f, floor %.3f, unbiased %.3f (%.3f to %.3f)\n",
              std::sqrt(itself.plain), std::sqrt(itself.floor), signed_root(itself.unbiased),
              itself.interval.low, itself.interval.high);
  EXPECT_LE(itself.interval.low, 0);
  EXPECT_GE(itself.interval.high, 0);
  EXPECT_GT(std::sqrt(itself.plain), 0.05);
  EXPECT_NEAR(std::sqrt(itself.plain), std::sqrt(itself.floor), 0.1 * std::sqrt(itself.floor));
  // The plain light model's error is far larger than the noise, also after the noise is subtracted.
  const SquaredError plain = raster_error(scene, simulated, full);
  EXPECT_GT(plain.interval.low, 0.1);
  EXPECT_LT(plain.unbiased, plain.plain);
}

TEST_F(Blender, NoiseFallsWithTheSamplesAsked) {
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "noise");
  const Noise noise = measure_noise(*worker_, scene, simulate(prepared, scene.placement, scene.adversary));
  EXPECT_GT(noise.relative, 0.005);
  EXPECT_LT(noise.relative, 0.5);
  EXPECT_EQ(samples_for(noise, noise.relative / 2), 4 * noise.samples);
  EXPECT_EQ(samples_for(noise, 1), 4);
  EXPECT_EQ(samples_for(noise, 1e-9), 4096);
}

TEST_F(Blender, AnFbxIsOpenedWithTheSameVerticesTexelsAndPivot) {
  const test::TemporaryFolder folder;
  TexturedMesh given = test::random_mesh(4, 5);
  for (Vec3d& v : given.mesh.vertices) v += Vec3d(0.1, -0.05, 0.3);  // its middle is not its pivot
  const TexturedMesh standing = standing_on_origin(given);
  worker_->write_fbx(folder / "adversary.fbx", given);
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
    files += entry.path().extension() == ".fbx" || entry.path().extension() == ".glb";
  EXPECT_EQ(files, 1u);
  const auto seen = worker_->request({{"job", "inspect"}, {"file", (folder / "adversary.fbx").string()}}, 60);
  EXPECT_EQ(seen.at("materials"), 1);
  EXPECT_EQ(seen.at("pictures"), 1);
  EXPECT_TRUE(seen.at("packed").get<bool>());
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_NEAR(seen.at("origin").at(k).get<double>(), 0, 1e-6);
    EXPECT_NEAR(seen.at("scale").at(k).get<double>(), 1, 1e-5);
  }
  const auto triangles = atlas_triangles(given.atlas.resolution);
  const auto& corners = seen.at("triangles");
  const auto& texels = seen.at("texels");
  ASSERT_EQ(corners.size(), given.mesh.faces.size() * triangles.size());
  ASSERT_EQ(texels.size(), corners.size());
  double furthest = 0;
  int other = 0;
  std::size_t at = 0;
  for (std::size_t f = 0; f < given.mesh.faces.size(); ++f)
    for (const AtlasTriangle& triangle : triangles) {
      // A program may list a triangle's corners from another one on.
      double best = 1e9;
      for (int turn = 0; turn < 3; ++turn) {
        double worst = 0;
        for (int k = 0; k < 3; ++k) {
          const Vec2d& b = triangle.corners[as_size(k)];
          const Face& face = standing.mesh.faces[f];
          const auto vertex = [&](int of) { return standing.mesh.vertices[as_size(face[as_size(of)])]; };
          const Vec3d expected = b.x() * vertex(0) + b.y() * vertex(1) + (1 - b.x() - b.y()) * vertex(2);
          const auto& p = corners.at(at).at(as_size((k + turn) % 3));
          worst = std::max(worst, (Vec3d(p.at(0), p.at(1), p.at(2)) - expected).norm());
        }
        best = std::min(best, worst);
      }
      furthest = std::max(furthest, best);
      ImageF one(1, 1, 3);
      const Vec3d& texel = given.atlas.texels[f * given.atlas.per_face() + as_size(triangle.texel)];
      for (int c = 0; c < 3; ++c) one.data[as_size(c)] = static_cast<float>(texel[c]);
      const auto bytes = srgb_bytes(one);
      for (std::size_t c = 0; c < 3; ++c) other += texels.at(at).at(c) != bytes[c];
      ++at;
    }
  EXPECT_LT(furthest, 2e-6);
  EXPECT_EQ(other, 0);
}

TEST(LidarLadder, IdealChangesNothingAndEachEffectDoesWhatItSays) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  const PreparedFrame prepared = test::made_up_frame();
  const auto scene = test::host_scene_of(prepared, test::random_mesh(2), "lidar-ladder");
  std::map<std::string, LidarRung> rungs;
  for (LidarRung& rung : lidar_ladder(scene)) rungs[rung.effect] = rung;
  const int count = rungs.at("ideal").returns;
  ASSERT_GT(count, 50);
  EXPECT_EQ(rungs.at("ideal").changed, 0);
  EXPECT_EQ(rungs.at("noise").returns, count);
  EXPECT_GT(rungs.at("noise").changed, 0.9);  // 2 cm of noise stay below 1 mm once in 25 rays
  EXPECT_NEAR(rungs.at("drop-out").changed, 0.1, 4 * std::sqrt(0.09 / count));
  EXPECT_NEAR(rungs.at("drop-out").changed, -rungs.at("drop-out").returns_change, 1e-12);
  EXPECT_GT(rungs.at("divergence").changed, 0);
  EXPECT_GT(rungs.at("all").changed, 0.9);
  for (const auto& [effect, rung] : rungs) EXPECT_LE(rung.changed, 1) << effect;
  EXPECT_EQ(rungs.at("all").sweep.size() > 0, true);
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

// An attack whose detector sees Blender Cycles' pictures. Skipped if Blender is not installed.

namespace {

#define MIRAGE_NEED_BLENDER() \
  if (find_program("blender").empty()) GTEST_SKIP() << "blender is not installed"

TEST(CyclesRenderer, DrawsFullLightOverThePhotograph) {
  MIRAGE_NEED_BLENDER();
  const PreparedFrame prepared = test::made_up_frame();
  HostScene scene = test::host_scene_of(prepared, test::random_mesh(3), "cycles-renderer");
  const Simulated simulated = simulate_host(scene, scene.simulation);
  const HostId host{"made-up", 0};
  const HostInWorld in_world{prepared, host, scene.placement, scene.simulation};
  CyclesRenderer renderer({test::scratch("cycles-renderer-out"), 32, 1, "blender"});
  const auto draw = [&](std::uint64_t seed) {
    return renderer.draw(in_world, scene.adversary, simulated, seed).picture;
  };
  const ImageF first = draw(1);
  EXPECT_EQ(draw(1).data, first.data);
  EXPECT_NE(draw(2).data, first.data);

  const auto blender = start_blender(test::scratch("cycles-renderer-full"));
  scene.samples = 64;
  const FullLight full = full_light(*blender, scene, simulated);
  ASSERT_EQ(first.width, full.rect.width());
  ImageF seen = first;
  saturate(seen);
  const double noisy = mean_absolute_error(full.cycles, seen, full.mask),
               raster = mean_absolute_error(full.cycles, full.raster, full.mask);
  EXPECT_LT(noisy, 0.5 * raster) << "32 samples are nearer to 64 others than the rasteriser is";
  // Beside object and shadow it equals the photograph.
  EXPECT_NEAR(first.at(0, 0, 0), prepared.frame.image.at(full.rect.u0, full.rect.v0, 0), 1e-4);
}

TEST(CyclesRenderer, WithoutBlenderThereIsOneLine) {
  const test::TemporaryFolder folder;
  EXPECT_THAT(test::error_text<InputError>([&] {
                CyclesRenderer({folder / "out", 1, 1, "no-such-blender"});
              }),
              testing::AllOf(testing::HasSubstr("no-such-blender"), testing::HasSubstr("not found on PATH")));
}

/// An attack on tiny frames with a renderer's pictures: three frames and one stand-in detector, for several
/// runs.
class RenderedAttack {
 public:
  /// The renderer of the run in a folder; null: the rasteriser.
  using MakeRenderer = std::function<std::shared_ptr<ObjectRenderer>(const std::filesystem::path& out)>;

  RenderedAttack() {
    test::write_tiny_data(folder_ / "data", 3);
    detectors_.push_back(std::make_unique<test::StandInDetector>());
  }

  /// The folder of a run.
  std::filesystem::path out(const char* run) const { return folder_ / run; }

  /// Trains up to `iterations`, from the run's checkpoint if it has one; returns the checkpoint.
  nlohmann::json learn(const char* run, int iterations, const MakeRenderer& renderer) {
    AttackSettings settings = test::tiny_attack();
    settings.data = folder_ / "data";
    settings.out = out(run);
    settings.iterations = iterations;
    settings.vertex_rate = 5e-3;
    settings.rooftop = "box";
    settings.quiet = true;
    settings.renderer = renderer(settings.out);
    settings.redraw = {0.012, 0.05};
    run_attack(settings, detectors_);
    return read_json(settings.out / "checkpoint.json");
  }

  /// Expects equal bits from run "whole" of four iterations and from a run that stops after two of them.
  void expect_same_bits_in_parts(const MakeRenderer& renderer) {
    learn("parts", 2, renderer);
    learn("parts", 4, renderer);
    for (const char* file : {"adversary.glb", "loss.csv"})
      EXPECT_EQ(read_file(out("whole") / file), read_file(out("parts") / file)) << file;
  }

 private:
  test::TemporaryFolder folder_;
  DetectorPool detectors_;
};

TEST(CyclesRenderer, AnAttackLooksAtItAndGoesOnToTheSameBits) {
  MIRAGE_NEED_BLENDER();
  RenderedAttack attack;
  const auto cycles = [](const std::filesystem::path& out) {
    return std::make_shared<CyclesRenderer>(CyclesRenderer::Settings{out, 1, 1, "blender"});
  };
  const nlohmann::json whole = attack.learn("whole", 4, cycles),
                       raster = attack.learn("raster", 4, [](const auto&) { return nullptr; });
  EXPECT_NE(whole.at("losses")[0], raster.at("losses")[0]);
  EXPECT_EQ(whole.at("identity").at("renderer").at("name"), "cycles");
  attack.expect_same_bits_in_parts(cycles);
  EXPECT_FALSE(std::filesystem::exists(attack.out("whole") / kScratchFolder));
}

}  // namespace
}  // namespace mirage
