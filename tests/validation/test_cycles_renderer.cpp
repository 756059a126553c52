// An attack's detector looks at Blender Cycles. Skipped where Blender is not installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <memory>

#include "attack/attack.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "fixture.h"
#include "support/files.h"
#include "validation/blender/cycles_renderer.h"
#include "validation/blender/scratch_folder.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

#define MIRAGE_NEED_BLENDER() \
  if (find_program("blender").empty()) GTEST_SKIP() << "blender is not installed"

TEST(CyclesRenderer, DrawsFullLightOverThePhotograph) {
  MIRAGE_NEED_BLENDER();
  const PreparedFrame prepared = test::made_up_frame();
  HostScene scene = test::host_scene_of(prepared, test::random_mesh(3), "cycles-renderer");
  const Simulated simulated = simulate_host(scene, scene.simulation);
  Host host;
  host.id = {"made-up", 0};
  const HostInWorld in_world{prepared, host, scene.rooftop, scene.simulation};
  CyclesRenderer renderer({test::scratch("cycles-renderer-out"), 32, 1, "blender"});
  const auto draw = [&](std::uint64_t seed) {
    return renderer.draw(in_world, scene.adversary, simulated, seed).picture;
  };
  const ImageF first = draw(1);
  EXPECT_EQ(draw(1).data, first.data);
  EXPECT_NE(draw(2).data, first.data);

  BlenderWorker blender(test::scratch("cycles-renderer.log"));
  scene.samples = 64;
  const FullLight full = full_light(blender, scene, simulated);
  ASSERT_EQ(first.width, full.rect.width());
  ImageF seen = first;
  saturate(seen);
  const double noisy = mean_absolute_error(full.cycles, seen, full.mask),
               raster = mean_absolute_error(full.cycles, full.raster, full.mask);
  EXPECT_LT(noisy, 0.5 * raster) << "32 samples are nearer to 64 others than the rasteriser is";
  // Beside object and shadow it is the photograph.
  EXPECT_NEAR(first.at(0, 0, 0), prepared.frame.image.at(full.rect.u0, full.rect.v0, 0), 1e-4);
}

TEST(CyclesRenderer, WithoutBlenderThereIsOneLine) {
  const test::TemporaryFolder folder;
  EXPECT_THAT(test::error_text<InputError>([&] {
                CyclesRenderer({folder / "out", 1, 1, "no-such-blender"});
              }),
              testing::AllOf(testing::HasSubstr("no-such-blender"), testing::HasSubstr("not found on PATH")));
}

TEST(CyclesRenderer, AnAttackLooksAtItAndGoesOnToTheSameBits) {
  MIRAGE_NEED_BLENDER();
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  const auto attack = [&](const char* out, int iterations, bool cycles) {
    AttackSettings settings = test::tiny_attack();
    settings.data = folder / "data";
    settings.out = folder / out;
    settings.iterations = iterations;
    settings.vertex_rate = 5e-3;
    settings.rooftop = "box";
    settings.quiet = true;
    if (cycles) {
      settings.renderer =
          std::make_shared<CyclesRenderer>(CyclesRenderer::Settings{folder / out, 1, 1, "blender"});
      settings.renewal = {0.012, 0.05};
    }
    run_attack(settings, detectors);
    return read_json(folder / out / "checkpoint.json");
  };
  const nlohmann::json whole = attack("whole", 4, true), raster = attack("raster", 4, false);
  EXPECT_NE(whole.at("losses")[0], raster.at("losses")[0]);
  EXPECT_EQ(whole.at("identity").at("renderer").at("name"), "cycles");
  attack("parts", 2, true);
  attack("parts", 4, true);
  for (const char* file : {"adversary.glb", "loss.csv"})
    EXPECT_EQ(read_file(folder / "whole" / file), read_file(folder / "parts" / file)) << file;
  EXPECT_FALSE(std::filesystem::exists(folder / "whole" / kScratchFolder));
}

}  // namespace
}  // namespace mirage
