// Fidelity metrics against values worked out by hand and values of scikit-image 0.19.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "fixture.h"
#include "plain_reference.h"
#include "support/files.h"
#include "validation/fidelity/ladders.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

/// A picture from integer arithmetic, so that other programs can make the same one.
ImageF pattern(int k) {
  ImageF image(24, 20, 1);
  for (int v = 0; v < 20; ++v)
    for (int u = 0; u < 24; ++u)
      image.at(u, v) = static_cast<float>((u * 7 + v * 13 + k * (u * v % 11)) % 32) / 31.0f;
  return image;
}

ImageF constant(float r, float g, float b) {
  ImageF image(40, 30, 3);
  for (int i = 0; i < 40 * 30; ++i)
    image.data[as_size(3 * i)] = r, image.data[as_size(3 * i + 1)] = g, image.data[as_size(3 * i + 2)] = b;
  return image;
}

TEST(Fidelity, ErrorsByHand) {
  ImageF a(2, 1, 3), b(2, 1, 3), mask(2, 1, 1);
  a.data = {0.1f, 0.2f, 0.3f, 1.0f, 1.0f, 1.0f};
  b.data = {0.1f, 0.2f, 0.6f, 0.0f, 1.0f, 0.5f};
  EXPECT_NEAR(mean_absolute_error(a, b), 1.8 / 6, 1e-7);
  EXPECT_NEAR(max_absolute_error(a, b), 1, 1e-7);
  mask.data = {1, 0};
  EXPECT_NEAR(mean_absolute_error(a, b, mask), 0.1, 1e-7);
  EXPECT_NEAR(max_absolute_error(a, b, mask), 0.3, 1e-7);
  EXPECT_NEAR(psnr(a, b, mask), -10 * std::log10(0.03), 1e-5);
  mask.data = {0, 0};
  EXPECT_EQ(mean_absolute_error(a, b, mask), 0);
}

TEST(Fidelity, MaskIou) {
  ImageF a(4, 1, 1), b(4, 1, 1);
  EXPECT_EQ(mask_iou(a, b), 1);
  a.data = {1, 1, 1, 0};
  b.data = {0, 1, 1, 1};
  EXPECT_EQ(mask_iou(a, b), 0.5);
}

TEST(Fidelity, PsnrAndSsimAsScikitImage) {
  const ImageF a = pattern(0), b = pattern(1);
  EXPECT_NEAR(psnr(a, b), 9.404022538322991, 1e-5);
  // structural_similarity(gaussian_weights, sigma 1.5, use_sample_covariance False, win_size 11), mean of
  // [5:-5, 5:-5]
  ImageF interior(24, 20, 1);
  for (int v = 5; v < 15; ++v)
    for (int u = 5; u < 19; ++u) interior.at(u, v) = 1;
  EXPECT_NEAR(ssim(a, b, interior), 0.28629069066686413, 1e-5);
  EXPECT_NEAR(ssim(a, a), 1, 1e-12);
  EXPECT_LT(ssim(a, b), 0.6);
}

TEST(Fidelity, FlipOfEqualPicturesIsZeroAndOfGreenAgainstBlueIsOne) {
  EXPECT_EQ(flip(constant(0.3f, 0.5f, 0.7f), constant(0.3f, 0.5f, 0.7f)), 0);
  // The paper normalises by the most distant pair of its colour space (section 4.1.3).
  EXPECT_NEAR(flip(constant(0, 1, 0), constant(0, 0, 1)), 1, 1e-5);
}

TEST(Fidelity, FlipOfConstantsByHand) {
  // White against black: HyAB is ΔL = 100, and 100^0.7 = 25.119. Green against blue (Hunt-adjusted CIELAB)
  // has 203.297^0.7 = 41.275; the knee is at 0.4 of that, 16.510: 0.95 + 0.05 (25.119 − 16.510) / (41.275
  // − 16.510).
  EXPECT_NEAR(flip(constant(1, 1, 1), constant(0, 0, 0)), 0.96738, 1e-4);
}

TEST(Fidelity, FlipSeesAnEdgeMoreThanAFlatChange) {
  ImageF flat = constant(0.5f, 0.5f, 0.5f), edge = flat, shifted = flat;
  for (int v = 0; v < 30; ++v)
    for (int u = 0; u < 40; ++u)
      for (int c = 0; c < 3; ++c) {
        edge.at(u, v, c) = u < 20 ? 0.55f : 0.45f;
        shifted.at(u, v, c) = 0.55f;
      }
  ImageF middle(40, 30, 1);
  for (int v = 0; v < 30; ++v) middle.at(18, v) = 1;
  EXPECT_GT(flip(flat, edge, middle), flip(flat, shifted, middle));
}

}  // namespace

// Results of a validation with a reference renderer that has known differences.

namespace {

using test::PlainReference;

/// The scene of a made-up car, further away than in Blender's tests, for fewer pixels.
struct Reference : public ::testing::Test {
  const PreparedFrame prepared = test::made_up_frame(20, 2, 0.6);
  const test::TemporaryFolder folder;
  HostScene scene = test::host_scene_of(prepared, test::random_mesh(2), "reference");

  MatchedLight matched(const test::Planted& planted) {
    PlainReference reference(planted);
    return matched_light(reference, scene);
  }
  MatchedResult rays(const test::Planted& planted) {
    PlainReference reference(planted);
    return check_lidar(reference, scene, simulate_host(scene, scene.simulation));
  }
};

TEST_F(Reference, APlainLoopAgreesWithRasteriserAndRays) {
  const MatchedLight light = matched({});
  EXPECT_GE(light.mask_iou, 0.999);
  EXPECT_GT(light.mask_both, 300);
  EXPECT_LE(light.mae, 1e-3);  // a pixel's centre on a border between texels may show either
  EXPECT_LE(light.pixels_off, light.mask_either / 200);
  EXPECT_LE(light.depth_error, 1e-3);
  const MatchedResult lidar = rays({});
  EXPECT_GT(lidar.returns, 10);
  EXPECT_GE(lidar.rays, lidar.returns);
  EXPECT_EQ(lidar.hit_disagreements, 0);
  EXPECT_LE(lidar.range_error, 1e-4);
}

TEST_F(Reference, ASideCameraIsComparedAsTheFirst) {
  Frame frame = prepared.frame;
  const Vec3d roof = scene.placement.velo_from_adversary.translation();
  Transform velo_from_turned = Transform::Identity();  // looks right, from the car's left
  velo_from_turned.linear() = Eigen::AngleAxisd(-M_PI / 2, Vec3d::UnitZ()).toRotationMatrix();
  velo_from_turned.translation() = Vec3d(roof.x(), roof.y() + 14, 0);
  SideCamera side{"SIDE", frame.calibration, Lazy<ImageF>([] { return ImageF(1242, 375, 3, 0.4f); })};
  side.calibration.camera_from_velo = frame.calibration.camera_from_velo * velo_from_turned.inverse();
  frame.others = {side};
  frame.labels[0].camera = 1;  // selects the vehicle's paint
  const PreparedFrame both = prepare(frame, prepared.lidar), turned = facing(both, 1);
  EXPECT_EQ(turned.frame.camera, "SIDE");
  EXPECT_EQ(turned.frame.labels[0].camera, 0);
  EXPECT_EQ(turned.frame.others[0].name, frame.camera);
  HostScene of = test::host_scene_of(both, test::random_mesh(2), "surround");
  of.simulation.light = LightModel::visible;
  HostScene there = facing(of, turned, 1);
  const Simulated as_side = simulate_host(of, of.simulation),
                  as_first = simulate_host(there, there.simulation);
  ASSERT_GT(as_side.adversary_pixels, 300);
  EXPECT_EQ(as_first.image.data, as_side.others[0].image.data);
  EXPECT_EQ(as_first.others[0].image.data, as_side.image.data);
  there.glb = test::scratch("surround-side.glb");
  write_scene(there.glb, host_scene(turned.frame, there.placement, there.adversary, "side"));
  PlainReference reference, wrong({.gain = 1.25});
  const MatchedLight light = matched_light(reference, there);
  EXPECT_GT(light.mask_both, 300);
  EXPECT_GE(light.mask_iou, 0.999);
  EXPECT_LE(light.mae, 1e-3);
  EXPECT_LE(light.depth_error, 1e-3);
  EXPECT_GT(matched_light(wrong, there).mae, 0.02);
}

TEST_F(Reference, BrighterLightIsAnErrorOfTheColourAlone) {
  const MatchedLight plain = matched({}), bright = matched({.gain = 1.25});
  EXPECT_EQ(bright.mask_iou, plain.mask_iou);
  EXPECT_EQ(bright.depth_error, plain.depth_error);
  // Mean radiance over the mask; a quarter of it is the error.
  const double mean = mean_absolute_error(plain.raster, ImageF(plain.rect.width(), plain.rect.height(), 3),
                                          plain.raster_mask);
  EXPECT_NEAR(bright.mae, 0.25 * mean, 1e-3);
  EXPECT_GT(bright.pixels_off, 0.95 * bright.mask_either);
}

TEST_F(Reference, AShiftByAPixelIsSeenInTheMask) {
  const MatchedLight plain = matched({}), shifted = matched({.shift = 1});
  // Both masks by hand: the reference's own one pixel to the right.
  int both = 0, either = 0;
  const ImageF& mask = plain.raster_mask;
  for (int v = 0; v < mask.height; ++v)
    for (int u = 1; u < mask.width; ++u) {
      const bool here = mask.at(u, v) > 0.5f, left = mask.at(u - 1, v) > 0.5f;
      both += here && left, either += here || left;
    }
  EXPECT_NEAR(shifted.mask_iou, static_cast<double>(both) / either, 2e-3);
  EXPECT_LT(shifted.mask_iou, 0.98);
}

TEST_F(Reference, RangesThatAreOffAndRaysThatPassAreCounted) {
  EXPECT_NEAR(rays({.range = 0.005}).range_error, 0.005, 1e-4);
  EXPECT_EQ(rays({.range = 0.005}).hit_disagreements, 0);
  // Rays that pass through the object, and the returns that they would give.
  const MatchedResult passing = rays({.misses = 3});
  EXPECT_GE(passing.hit_disagreements, 3);
  EXPECT_LE(passing.hit_disagreements, 6);
  EXPECT_NEAR(matched({.range = 0.05}).depth_error_mean, 0.05, 5e-3);
}

TEST_F(Reference, TheErrorWithoutNoiseIsWhatWasPlanted) {
  // The object in the reference is a fifth darker, and a sample's brightness varies by 30 %.
  scene.samples = 8;
  scene.simulation = hard_limit(scene.simulation, true);
  scene.simulation.supersampling = 8;
  const Simulated drawn = simulate_host(scene, scene.simulation);
  const auto drawn_by = [&](const test::Planted& planted) {
    PlainReference reference(planted);
    return full_light(reference, scene, drawn);
  };
  const FullLight quiet = drawn_by({.bounces_gain = 0.8}),
                  noisy = drawn_by({.bounces_gain = 0.8, .noise = 0.3});
  const SquaredError without = raster_error(scene, drawn, quiet), with = raster_error(scene, drawn, noisy);
  // Shares of the mean radiance: for a texture the mean square exceeds the square of the mean.
  const ImageF& radiance = quiet.raster;  // without noise
  double sum = 0, squares = 0, count = 0;
  for (int v = 0; v < radiance.height; ++v)
    for (int u = 0; u < radiance.width; ++u)
      for (int c = 0; c < 3 && quiet.mask.at(u, v) > 0.5f; ++c, ++count)
        sum += radiance.at(u, v, c), squares += std::pow(radiance.at(u, v, c), 2);
  const double texture = squares / count / std::pow(sum / count, 2);
  // Eight samples estimate it within a quarter; with their noise it would be more than half as much again.
  EXPECT_NEAR(without.unbiased, 0.25 * 0.25 * texture, 0.25 * 0.25 * 0.25 * texture);
  EXPECT_GT(without.plain, 1.5 * without.unbiased);
  EXPECT_NEAR(with.unbiased, without.unbiased, 0.15 * without.unbiased);
  EXPECT_NEAR(with.plain, with.unbiased + with.floor, 1e-9);
  // Sample positions in a pixel add noise, too, and the quiet one has that as well.
  const double planted = 0.3 * 0.3 / quiet.samples * texture;
  EXPECT_NEAR(with.floor - without.floor, planted, 0.4 * planted);
  EXPECT_GT(noise_of(noisy.radiance, noisy.mask, noisy.samples / 2).relative,
            1.02 * noise_of(quiet.radiance, quiet.mask, quiet.samples / 2).relative);
}

TEST_F(Reference, TheLadderTellsTheEffectThatMatters) {
  scene.samples = 4;
  const Simulated simulated = simulate_host(scene, scene.simulation);
  PlainReference reference({.bounces_gain = 0.8});
  const FullLight full = full_light(reference, scene, simulated);
  std::map<std::string, LadderRung> rungs;
  for (LadderRung& rung : light_ladder(reference, scene, full).rungs) rungs[rung.effect] = rung;
  const auto left = [&](const char* effect) { return rungs.at(effect).error.unbiased; };
  for (const char* with_bounces : {"+bounces1", "+bounces4", "all", "full"})
    EXPECT_LT(left(with_bounces), 0.02) << with_bounces;
  for (const char* without : {"hard", "+pixel area", "+shadows", "+occlusion", "+specular"})
    EXPECT_GT(left(without), 0.04) << without;
  EXPECT_NEAR(rungs.at("+bounces1").change.relative, 0.2, 0.02);
  EXPECT_EQ(rungs.at("+shadows").change.mae, 0) << "the plain loop has none";
  EXPECT_EQ(rungs.at("+cast shadow").crop.mae, 0);
}

TEST_F(Reference, ARunOfExactAreasIsComparedAtPixelCentresToo) {
  scene.samples = 1;
  PlainReference reference;
  const FullLight full = full_light(reference, scene, simulate_host(scene, scene.simulation));
  const auto drawn = [&] {
    std::map<std::string, ImageF> pictures;
    for (LadderRung& rung : light_ladder(reference, scene, full).rungs)
      if (rung.group == "raster" && rung.effect != "soft") pictures[rung.effect] = std::move(rung.picture);
    return pictures;
  };
  const MatchedLight by_default = matched({});
  const auto default_rungs = drawn();
  apply_quality("exact", scene.simulation);
  ASSERT_TRUE(scene.simulation.exact_coverage);
  const MatchedLight exact = matched({});
  EXPECT_EQ(exact.raster.data, by_default.raster.data);
  EXPECT_EQ(exact.mae, by_default.mae);
  auto exact_rungs = drawn();
  for (const auto& [effect, picture] : default_rungs)
    EXPECT_EQ(exact_rungs[effect].data, picture.data) << effect;
  EXPECT_NE(exact_rungs["visible light"].data, exact_rungs["visible light, exact areas"].data);
}

TEST_F(Reference, OneThatIsLostSaysSo) {
  PlainReference reference({.lost_at = 1});
  EXPECT_THROW(matched_light(reference, scene), ReferenceLost);  // at its rays, after the picture
  ASSERT_EQ(reference.losses().size(), 1u);
  EXPECT_EQ(reference.losses()[0].job, "raycast");
}

}  // namespace
}  // namespace mirage
