// An attack's detector looks at Blender Cycles. Skipped where Blender is not installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <memory>

#include "base/error.h"
#include "fixture.h"
#include "rendered_attack.h"
#include "support/files.h"
#include "validation/blender/blender_process.h"
#include "validation/blender/cycles_renderer.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/scratch_folder.h"

namespace mirage {
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
  test::RenderedAttack attack;
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
