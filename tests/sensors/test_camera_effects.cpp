#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/random.h"
#include "sensors/camera_effects.h"
#include "support/files.h"

namespace mirage {
namespace {

Image<double> random_image(int width, int height, const char* purpose) {
  Image<double> image(width, height, 4);
  RandomStream random(3, purpose);
  for (double& value : image.data) value = random.uniform(-1, 1);
  return image;
}

double dot(const Image<double>& a, const Image<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += a.data[i] * b.data[i];
  return sum;
}

TEST(CameraEffects, WordsSayWhichAndRefuseOthers) {
  EXPECT_FALSE(parse_camera_effects("ideal").any());
  const CameraEffects unit = parse_camera_effects("unit"), both = parse_camera_effects("noise,blur");
  EXPECT_EQ(unit.blur_sigma, both.blur_sigma);
  EXPECT_EQ(unit.shot, both.shot);
  EXPECT_EQ(unit.read_sigma, both.read_sigma);
  EXPECT_TRUE(unit.noisy());
  EXPECT_FALSE(parse_camera_effects("blur").noisy());
  EXPECT_EQ(parse_camera_effects("noise").blur_sigma, 0);
  for (const char* bad : {"", "fog", ",blur", "blur,fog", "unit,noise", "ideal,blur"})
    EXPECT_THAT(test::error_text<InputError>([&] { parse_camera_effects(bad); }),
                testing::StartsWith("camera_effects: "))
        << bad;
}

TEST(CameraEffects, SofteningKeepsLevelsAndItsTransposeIsOne) {
  for (const auto& [width, height] : {std::pair(9, 7), std::pair(1, 1), std::pair(2, 5), std::pair(1, 4)})
    for (const double sigma : {1e-200, 0.3, kLensBlur, 1.0}) {
      Image<double> flat(width, height, 3, 0.25);
      soften(flat, sigma);
      for (const double value : flat.data) EXPECT_NEAR(value, 0.25, 1e-15);
      const Image<double> x = random_image(width, height, "x"), y = random_image(width, height, "y");
      Image<double> ax = x, aty = y;
      soften(ax, sigma);
      soften_vjp(aty, sigma);
      EXPECT_NEAR(dot(ax, y), dot(x, aty), 1e-13) << width << "x" << height << " " << sigma;
    }
}

TEST(CameraEffects, AnImpulseSpreadsAsTheGaussianSays) {
  Image<double> image(9, 9, 1);
  image.at(4, 4) = 1;
  soften(image, kLensBlur);
  EXPECT_NEAR(image.at(5, 4) / image.at(4, 4), std::exp(-0.5 / (kLensBlur * kLensBlur)), 1e-12);
  EXPECT_NEAR(image.at(5, 5) / image.at(4, 4), std::exp(-1 / (kLensBlur * kLensBlur)), 1e-12);
  double sum = 0;
  for (const double value : image.data) sum += value;
  EXPECT_NEAR(sum, 1, 1e-12);
}

}  // namespace
}  // namespace mirage
