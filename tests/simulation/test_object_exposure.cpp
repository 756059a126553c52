#include <gtest/gtest.h>

#include "base/random.h"
#include "base/sizes.h"
#include "simulation/camera_pass.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

ImageF textured(int width, int height) {
  ImageF photograph(width, height, 3);
  RandomStream random(5, "photograph");
  for (float& value : photograph.data) value = static_cast<float>(random.uniform());
  return photograph;
}

/// An opaque rectangle of one colour over the photograph, with the half-covered pixels of an edge.
Image<double> with_patch(const ImageF& photograph, const PixelRect& patch, const Vec3d& colour) {
  Image<double> rgba(photograph.width, photograph.height, 4);
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) {
      const bool inside = u >= patch.u0 && u < patch.u1 && v >= patch.v0 && v < patch.v1;
      const double covered = inside ? (u == patch.u0 ? 0.5 : 1) : 0;
      for (int c = 0; c < 3; ++c)
        rgba.at(u, v, c) = covered * colour[c] + (1 - covered) * photograph.at(u, v, c);
      rgba.at(u, v, 3) = covered;
    }
  return rgba;
}

TEST(ObjectExposure, OnlyTheEdgeIsSoftAndNoPhotographShowsThroughTheObject) {
  const ImageF photograph = textured(16, 14);
  const PixelRect patch{4, 3, 12, 11};
  const Vec3d colour(0.2, 0.5, 1.4);
  const Image<double> drawn = with_patch(photograph, patch, colour);
  Image<double> rgba = drawn;
  EXPECT_TRUE(expose_object(parse_camera_effects("blur"), photograph, 100, 50, rgba).empty());
  int soft = 0;
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) {
      const bool deep = u >= patch.u0 + 3 && u < patch.u1 - 2 && v >= patch.v0 + 2 && v < patch.v1 - 2;
      const bool far = u < patch.u0 - 2 || u >= patch.u1 + 2 || v < patch.v0 - 2 || v >= patch.v1 + 2;
      for (int c = 0; c < 3; ++c) {
        if (deep || far) {
          EXPECT_NEAR(rgba.at(u, v, c), deep ? colour[c] : photograph.at(u, v, c), 1e-12);
        }
        soft += !deep && !far && std::abs(rgba.at(u, v, c) - drawn.at(u, v, c)) > 1e-3;
      }
    }
  EXPECT_GT(soft, 100);
}

TEST(ObjectExposure, AnObjectAtThePicturesEdgeGoesOnBeyondIt) {
  const ImageF photograph = textured(8, 8);
  Image<double> rgba = with_patch(photograph, {-1, 0, 8, 8}, Vec3d(0.3, 0.3, 0.3));
  expose_object(parse_camera_effects("blur"), photograph, 0, 0, rgba);
  for (int i = 0; i < 64; ++i) EXPECT_NEAR(rgba.data[4 * as_size(i)], 0.3, 1e-12);
}

TEST(ObjectExposure, NoiseHasItsVarianceAndIsOfThePixelAlone) {
  const ImageF photograph(96, 96, 3, 0.4f);
  for (const double covered : {1.0, 0.5}) {
    Image<double> rgba(96, 96, 4);
    for (std::size_t i = 0; i < rgba.data.size(); ++i) rgba.data[i] = i % 4 == 3 ? covered : 0.6;
    CameraEffects effects = parse_camera_effects("noise");
    Image<double> noisy = rgba, other = rgba, shifted(95, 96, 4, 0.6);
    expose_object(effects, photograph, 7, 3, noisy);
    double sum = 0, squares = 0;
    for (std::size_t i = 0; i < rgba.data.size(); ++i) {
      if (i % 4 == 3) {
        EXPECT_EQ(noisy.data[i], covered);
        continue;
      }
      sum += noisy.data[i] - 0.6;
      squares += std::pow(noisy.data[i] - 0.6, 2);
    }
    const double count = 3.0 * 96 * 96, sigma = covered * std::sqrt(7e-5 * 0.6 + 1.25e-3 * 1.25e-3);
    EXPECT_NEAR(std::sqrt(squares / count) / sigma, 1, 0.02);
    EXPECT_LT(std::abs(sum / count), 4 * sigma / std::sqrt(count));
    effects.seed = 1;
    expose_object(effects, photograph, 7, 3, other);
    EXPECT_NE(other.data[0], noisy.data[0]);
    effects.seed = 0;
    for (std::size_t i = 3; i < shifted.data.size(); i += 4) shifted.data[i] = covered;
    expose_object(effects, ImageF(95, 96, 3, 0.4f), 8, 3, shifted);
    EXPECT_EQ(shifted.at(0, 5, 1), noisy.at(1, 5, 1));
  }
}

TEST(ObjectExposure, NothingChangesBesideTheObject) {
  const ImageF photograph = textured(6, 6);
  Image<double> rgba = with_patch(photograph, {0, 0, 0, 0}, Vec3d::Zero());
  const Image<double> before = rgba;
  expose_object(parse_camera_effects("noise"), photograph, 0, 0, rgba);
  EXPECT_EQ(rgba.data, before.data);
}

TEST(ObjectExposureGradient, OfColourAndSilhouette) {
  const ImageF photograph = textured(7, 6);
  RandomStream random(11, "drawn");
  Image<double> rgba(7, 6, 4);
  for (std::size_t i = 0; i < rgba.data.size(); ++i)
    rgba.data[i] = i % 4 == 3 ? random.uniform(0.05, 1) : random.uniform(0.02, 1.5);
  rgba.at(2, 2, 0) = -0.3;  // a negative radiance has the noise of black
  std::vector<double> weights(rgba.data.size());
  for (double& w : weights) w = random.uniform(-1, 1);
  for (const char* words : {"blur", "noise", "unit"}) {
    CameraEffects effects = parse_camera_effects(words);
    effects.shot *= 100;  // so that noise shows beside the identity
    const auto loss = [&](const std::vector<double>& x) {
      Image<double> at = rgba;
      at.data = x;
      expose_object(effects, photograph, 30, 40, at);
      double sum = 0;
      for (std::size_t i = 0; i < weights.size(); ++i) sum += weights[i] * at.data[i];
      return sum;
    };
    Image<double> after = rgba, d_rgba = rgba;
    const Image<double> softened = expose_object(effects, photograph, 30, 40, after);
    d_rgba.data = weights;
    expose_object_vjp(effects, photograph, 30, 40, softened, d_rgba);
    const auto checked = test::check_gradient(loss, rgba.data, d_rgba.data, 1e-5, 1e-6, 1e-3);
    std::printf("%s: %d components, worst relative error %.2e\n", words, checked.checked, checked.worst);
    EXPECT_EQ(checked.checked, static_cast<int>(weights.size()));
  }
}

}  // namespace
}  // namespace mirage
