// Fidelity metrics against hand values and values made with scikit-image 0.19.
#include <gtest/gtest.h>

#include <cmath>

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
    image.data[3 * i] = r, image.data[3 * i + 1] = g, image.data[3 * i + 2] = b;
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
  // The paper normalises by the pair that its colour space puts farthest apart (section 4.1.3).
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
}  // namespace mirage
